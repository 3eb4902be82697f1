"""Every sentence for a person: results are data, and each subject has one file that says it.

A sentence is short (25 words at most), its subject comes first, and its terms are the field's.
"""

from torchrbd.report.text.statements import in_words

__all__ = ["in_words"]
