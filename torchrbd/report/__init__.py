"""One self-contained HTML page with what was found. It renders results and computes nothing but bins for display."""

from torchrbd.report.changes import write_changes_report
from torchrbd.report.files import write_results
from torchrbd.report.page import write_report

__all__ = ["write_changes_report", "write_report", "write_results"]
