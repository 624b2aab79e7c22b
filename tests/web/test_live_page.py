"""The Live screen in a real browser, on a real server, with phones that post over HTTP."""

from collections.abc import Callable, Iterator

import pytest
from server_process import ServerProcess
from watched_page import LOST_SERVER, NOT_LOGGED_IN, WatchedPage
from yard import FLOORS, WALKERS

pytestmark = pytest.mark.browser

OpenPage = Callable[..., WatchedPage]

PAINTED = """
({px, py}) => {
  const canvas = document.querySelector(".people-canvas");
  const box = canvas.getBoundingClientRect();
  const scale = canvas.width / box.width;
  const [x, y] = [(px - box.left) * scale, (py - box.top) * scale];
  return [...canvas.getContext("2d").getImageData(x, y, 1, 1).data];
}
"""
SHOWN_ON = "id => window.__view.floor_id === id && window.__view.people().length > 0"


@pytest.fixture
def live(open_page: OpenPage) -> Iterator[WatchedPage]:
    """The page, logged in by its link, with everybody in sight."""
    page = open_page()
    page.until("window.__view.connection === 'live'")
    page.person("walker-1")
    return page


def test_people_move_on_the_canvas(live: WatchedPage) -> None:
    live.until_moved("walker-1")
    live.until_moved("walker-2")
    person = live.person("walker-1")
    assert person["status"] == "live"
    assert person["radius_px"] > 0
    # Where the mark is and where it was last drawn can be a frame apart.
    live.until(f"""(() => {{
        const mark = window.__view.people().find(p => p.device_id === "walker-1");
        const [red, green, blue, alpha] = ({PAINTED})(mark);
        return alpha === 255 && blue > red && blue > green;
    }})()""")
    assert "token" not in live.page.url


def test_the_list_counts_and_finds_people_by_keyboard(live: WatchedPage) -> None:
    live.until("document.querySelector('#counts [data-status=live] .count').textContent === '3'")
    live.page.keyboard.press("/")
    live.page.keyboard.type("WALKER-2")
    live.until("document.querySelectorAll('.row:not([hidden])').length === 1")
    live.page.keyboard.press("Enter")
    live.until("window.__view.selected_id === 'walker-2'")
    live.page.keyboard.press("/")
    live.page.keyboard.press("Escape")
    live.page.keyboard.press("k")
    live.until("window.__view.selected_id === 'walker-1'")
    live.page.keyboard.press("j")
    live.until("window.__view.selected_id === 'walker-2'")
    live.page.keyboard.press("Escape")
    live.until("window.__view.selected_id === null")


def test_a_click_on_the_map_tells_how_the_position_came_about(live: WatchedPage) -> None:
    live.click_person("walker-1")
    live.until("document.getElementById('detail-name').textContent === 'walker-1'")
    facts = live.page.inner_text("#detail-facts")
    for label in ("Last seen", "Floor certainty", "95 % radius", "Motion", "Method", "Readings"):
        assert label in facts
    assert "beacons" in facts
    assert FLOORS[WALKERS["walker-1"]] in facts


def test_floors_are_switched_and_selection_turns_to_the_right_one(live: WatchedPage) -> None:
    live.page.click("[data-floor-id=yard-upper]")
    live.until(SHOWN_ON, "yard-upper")
    assert [p["device_id"] for p in live.evaluate("window.__view.people()")] == ["walker-3"]
    live.page.click("[data-device-id=walker-1]")
    live.until(SHOWN_ON, "yard-ground")
    live.until("document.querySelector('img.plan-image').naturalWidth === 600")


def test_the_view_is_steered_by_keyboard(live: WatchedPage) -> None:
    where = "() => Object.values(window.__view.toPixels(15, 10)).map(Math.round)"
    start = live.evaluate(where)
    scale = "window.__view.toPixels(1, 0).px - window.__view.toPixels(0, 0).px"
    px_per_m = live.evaluate(scale)
    live.page.keyboard.press("ArrowRight")
    live.until(f"([x, y]) => ({where})()[0] < x", start)
    live.page.keyboard.press("+")
    live.until(f"was => {scale} > was", px_per_m)
    live.page.keyboard.press("-")
    live.page.keyboard.press("f")
    live.until(f"start => String(({where})()) === String(start)", start)


def test_a_followed_person_stays_in_the_middle(live: WatchedPage) -> None:
    live.page.keyboard.press("j")
    live.page.click("#follow")
    live.until_moved("walker-1", metres=1.0)
    box = live.page.locator("#map").bounding_box()
    assert box is not None
    person = live.person("walker-1")
    assert person["px"] == pytest.approx(box["x"] + box["width"] / 2, abs=30)
    assert person["py"] == pytest.approx(box["y"] + box["height"] / 2, abs=30)
    live.page.keyboard.press("f")
    live.until("window.__view.following === false")


def test_both_colour_schemes(open_page: OpenPage) -> None:
    shades = {}
    for scheme in ("light", "dark"):
        page = open_page(color_scheme=scheme)
        page.person("walker-1")
        shades[scheme] = _shades(page)
    assert shades["light"]["panel"] > 200 > 100 > shades["dark"]["panel"]
    assert shades["light"]["text"] < 100 < 200 < shades["dark"]["text"]
    page.page.click("#theme-toggle")
    assert _shades(page) == shades["light"]


def _shades(page: WatchedPage) -> dict[str, float]:
    """Return how light (0 to 255) the page's ground and its writing are."""
    shades: dict[str, float] = page.evaluate(
        """() => {
          const mean = colour => colour.match(/\\d+/g).slice(0, 3).reduce((a, c) => a + c / 3, 0);
          const style = getComputedStyle(document.body);
          return {panel: mean(style.backgroundColor), text: mean(style.color)};
        }"""
    )
    return shades


def test_without_a_link_the_page_asks_for_a_token(
    open_page: OpenPage, yard_server: ServerProcess
) -> None:
    page = open_page(by_link=False, expected=NOT_LOGGED_IN)
    page.until("document.getElementById('login').open")
    page.page.fill("#token", "wrong")
    page.page.keyboard.press("Enter")
    page.until("document.getElementById('login-problem').textContent !== ''")
    page.page.fill("#token", yard_server.token)
    page.page.keyboard.press("Enter")
    page.until("window.__view.connection === 'live'")
    assert page.evaluate("document.cookie") == ""


def test_the_page_comes_back_by_itself_after_the_server_was_killed(
    live: WatchedPage, yard_server: ServerProcess
) -> None:
    live.page.keyboard.press("j")
    with live.expecting(LOST_SERVER):
        yard_server.kill()
        live.until("document.getElementById('connection').textContent === 'Reconnecting'")
        yard_server.start()
        live.until("window.__view.connection === 'live'")
    assert live.evaluate("window.__view.selected_id") == "walker-1"
    live.until_moved("walker-1")


def test_waits_between_attempts_grow_to_a_bound_and_differ(live: WatchedPage) -> None:
    waits = live.evaluate(
        """async () => {
          const script = document.querySelector("script[src$='main.js']").src;
          const { backoffDelayMs } = await import(new URL("stream.js", script));
          return [0, 1, 2, 20].map(n => [0, 0.999].map(chance => backoffDelayMs(n, chance)));
        }"""
    )
    lowest, highest = zip(*waits, strict=True)
    assert list(lowest) == pytest.approx([250, 500, 1000, 4000])
    assert list(highest) == pytest.approx([500, 1000, 2000, 8000], rel=1e-2)
