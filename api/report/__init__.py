"""Reports: `content` says what may be shown, `write_report` makes one self-contained page of it."""

from __future__ import annotations

from api.report.content import ReportContent
from api.report.page import write_report
from api.report.picture import write_summary_picture

__all__ = ["ReportContent", "write_report", "write_summary_picture"]
