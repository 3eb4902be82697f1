"""One self-contained HTML page with what was found. It renders results and computes nothing but bins for display."""

from torchrbd.report.page import write_report

__all__ = ["write_report"]
