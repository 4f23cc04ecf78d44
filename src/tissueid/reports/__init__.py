"""Reports: figures, and one self-contained HTML page for a session (docs/report.md)."""

from tissueid.reports.comparison_page import ComparisonReport, comparison_report
from tissueid.reports.session_page import report_html, write_report
from tissueid.reports.tables import ComparisonRow, ComparisonTable

__all__ = ["ComparisonReport", "ComparisonRow", "ComparisonTable", "comparison_report", "report_html", "write_report"]
