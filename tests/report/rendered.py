"""The page of a result, and its text."""

from html.parser import HTMLParser
from pathlib import Path
from typing import Any

from torchrbd.report import write_report


def render(result: Any, folder: Path) -> str:
    write_report(result, folder / "report.html")
    return (folder / "report.html").read_text(encoding="utf-8")


class Text(HTMLParser):
    """Collect the text of the body and check that every element is closed."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.words: list[str] = []
        self.open: list[str] = []
        self.feed(page)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag, attrs):
        if tag not in ("meta", "br"):
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        pass

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if data.strip() and "body" in self.open:
            self.words.append(" ".join(data.split()))


def tidy(text: str) -> str:
    return text.replace("\N{NO-BREAK SPACE}", " ")
