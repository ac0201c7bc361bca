import pytest

from studies.report import svg


@pytest.fixture
def blank_figures(monkeypatch):
    """Figures are drawn and not rendered, which takes most of the time of a page whose words are tested."""
    monkeypatch.setattr(svg, "render_svg", lambda figure: b'<svg viewBox="0 0 1 1"></svg>')
