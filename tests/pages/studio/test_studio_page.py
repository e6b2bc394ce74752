"""The page of `simgrab studio` in a real browser: a control of each type, what it changes, and what is shown of it."""

import tomllib
from operator import attrgetter

import pytest
from browser import NAMELESS, needs_chromium

from scripts.chromium import page
from simgrab.io.strict import convert
from simgrab.model import scenes
from simgrab.model.scenario import RandomPlace, Scenario, merged, schema
from simgrab.pages.studio import studio
from simgrab.pages.studio.documents import Documents

pytestmark = [pytest.mark.slow, needs_chromium]
HOSTILE = "<img src=x onerror=document.title=1><script>document.title=2"
SCENE = {
    "base": "quay-day", "name": "yard", "description": HOSTILE, "frames": 9,
    "camera": {"width_px": 320, "height_px": 180, "focal": {"model": "lens", "pixels_per_mm": 57.0}},
    "swing": {"load": {"dist": "choice", "values": [0.0, 0.6, 1.0], "weights": []}},
    "place": {"model": "plain"}, "jib": {"head": "none"}, "image": {"shadow_map_px": 1024},
}  # fmt: skip
PREPARED = """
window.row = (key) => document.querySelector(`[data-key="${CSS.escape(key).replaceAll("\\\\", "\\\\")}"]`)
  ?? [...document.querySelectorAll("[data-key]")].find((one) => one.dataset.key === key);
window.part = (key, selector) => row(key).querySelector(`:scope > .input ${selector}, :scope > .body > ${selector}`);
window.put = (input, value, kind = "change") => {
  if (input.type === "checkbox") input.checked = value;
  else input.value = value;
  input.dispatchEvent(new Event(kind, { bubbles: true }));
};
window.press = (id) => document.getElementById(id).click();
window.view = (side = "a") => document.querySelector(`[data-side="${side}"]`);
window.toml = async () => {
  const before = document.querySelector("#panel-file pre");
  press("tab-truth");
  press("tab-file");
  for (let i = 0; i < 200; i++) {
    await new Promise((done) => setTimeout(done, 20));
    const now = document.querySelector("#panel-file pre");
    if (now && now !== before) return now.textContent;
  }
  return "";
};
window.seen = (layer) => [...view().querySelectorAll(`.overlay .${layer}`)]
  .some((one) => getComputedStyle(one).display !== "none");
"""
FULL = 'view().dataset.small === "false" && document.querySelector("#views .message").hidden'


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    import tomli_w

    folder = tmp_path_factory.mktemp("studio")
    (folder / "yard.toml").write_text(tomli_w.dumps(SCENE))
    (folder / "other.toml").write_text(tomli_w.dumps(SCENE | {"name": "other", "light": {"sky": 0.5}}))
    return folder


@pytest.fixture(scope="module")
def shown(folder):
    with studio.serving(Documents(folder / "yard.toml", folder)) as address, page() as shown:
        shown.look(1440, 1000)
        shown.open(address.url)
        shown.wait('document.body?.dataset.ready === "yes"')
        shown.evaluate(PREPARED)
        shown.wait(FULL)
        yield shown
        assert [line for line in shown.console if "422" not in line and "409" not in line] == []


@pytest.fixture(autouse=True)
def as_before(shown):
    """Begin with the scene as it was opened."""
    yield
    shown.evaluate('while (!document.getElementById("undo").disabled) press("undo")')
    act_and_wait(shown)


def act_and_wait(shown, act=""):
    """Do something, and wait until the full frame is shown."""
    if act:
        shown.evaluate(f"(() => {{ window.drawn = view().dataset.drawn; {act} }})()")
        shown.wait("view().dataset.drawn !== window.drawn")
    shown.wait(FULL)


def scene(shown) -> Scenario:
    """What the page would save."""
    return convert(merged(Scenario().to_dict(), tomllib.loads(shown.evaluate("toml()"))), Scenario)


SEVERAL = ("clamshell", "four-rope")
CHANGES = [  # control, what a user does, the key, and its value
    ("slider", 'put(part("camera.beta_deg", "input[type=range]"), 100)', "camera.beta_deg", 10.0),
    ("number", 'put(part("swing.alpha.sigma_deg", "input[type=number]"), 7.5)', "swing.alpha.sigma_deg", 7.5),
    ("whole number", 'put(part("weather.lens_drops", "input[type=number]"), 4)', "weather.lens_drops", 4),
    ("switch", 'put(part("image.ids", "input"), true)', "image.ids", True),
    ("several or none", 'row("swing.clamp").querySelectorAll("input")[1].click()', "swing.clamp", ("rope_length_m",)),
    ("choice", 'put(part("grab.cargo", "select"), JSON.stringify("ore"))', "grab.cargo", "ore"),
    ("text", 'put(part("description", "input"), "plain")', "description", "plain"),
    ("optional", 'put(part("weather.visibility_m", "input"), true)', "weather.visibility_m", 1000.0),
    ("colour", 'put(part("grab.paint_rgb", "input[type=color]"), "#0000ff")', "grab.paint_rgb", (0.0, 0.0, 1.0)),
    ("numbers", 'put(part("camera.principal_offset_px", "input"), 12)', "camera.principal_offset_px", (12.0, 0.0)),
    ("several", 'row("clutter.kinds").querySelectorAll("input")[1].click()', "clutter.kinds", SEVERAL),
    ("kind", 'put(row("place.model").querySelector("select"), "random")', "place", RandomPlace()),
    ("layout", 'put(row("display.layout").querySelector("select"), "two-by-four")', "display.layout", "two-by-four"),
    ("list", 'row("swing.load.values").querySelector("button.remove").click()', "swing.load.values", (0.6, 1.0)),
    ("remove", 'document.querySelector("[aria-label=\\"Remove jib\\"]").click()', "jib.head", "portal"),
]  # fmt: skip


@pytest.mark.parametrize(("act", "key", "value"), [one[1:] for one in CHANGES], ids=[one[0] for one in CHANGES])
def test_a_control_of_each_type_changes_its_key_until_that_is_undone(shown, folder, act, key, value):
    before = scenes.load(folder / "yard.toml")
    if key == "display.layout":
        for name, pixels in (("width_px", 640), ("height_px", 360)):  # the display must fit
            act += f'; put(part("camera.{name}", "input[type=number]"), {pixels})'
    act_and_wait(shown, f"{act};")
    after = scene(shown)
    found = attrgetter(key)(after)
    assert (set(found) == set(value)) if key == "clutter.kinds" else (found == value)
    shown.evaluate('press("undo")')
    if key != "display.layout":
        act_and_wait(shown)
        assert scene(shown) == before
        shown.evaluate('press("redo")')
        assert scene(shown) == after


# Change every control, one after another, in every kind of every table; the server is not asked. What the page would
# send must differ at the control's key alone.
SWEEP = """(async () => {
  const ask = window.fetch;
  let sent = null;
  window.fetch = async (path, options) => {
    if (path === "/api/frame") sent = JSON.parse(options.body).scene;
    return new Response(JSON.stringify({ error: "not asked", key: "", problem: "" }), { status: 422 });
  };
  const changed = async (act) => {
    sent = null;
    act();
    for (let i = 0; i < 2000 && sent === null; i++) await new Promise((done) => setTimeout(done, 1));
    return sent;
  };
  const isTable = (value) => value && typeof value === "object" && !Array.isArray(value);
  const flat = (value, path = "") => (!isTable(value) ? [[path, JSON.stringify(value)]]
    : Object.entries(value).flatMap(([key, inner]) => flat(inner, path ? `${path}.${key}` : key)));
  const differing = (one, other) => {
    const [before, after] = [new Map(flat(one)), new Map(flat(other))];
    return [...new Set([...before.keys(), ...after.keys()])].filter((key) => before.get(key) !== after.get(key));
  };
  const move = (line) => {
    const slider = line.querySelector("input[type=range]");
    const input = slider ?? line.querySelector("select, input:not([type=color])");
    if (slider) put(slider, Number(slider.value) + (slider.value === slider.max ? -1 : 1));
    else if (input.tagName === "SELECT") put(input, [...input.options].find((one) => one.value !== input.value).value);
    else if (line.classList.contains("is-several")) line.querySelectorAll("input")[1].click();
    else if (input.type === "checkbox") input.click();
    else put(input, input.type === "number" ? Number(input.value) + 1 : `${input.value}x`);
  };
  const above = (key) => key.replace(/[^.]*$/, "");
  const visited = new Set();
  const wrong = [];
  let now = await changed(() => put(part("description", "input"), "swept"));
  const sweep = async (within) => {
    for (const key of [...within.querySelectorAll(".key:not(.is-kind)")].map((one) => one.dataset.key)) {
      const line = row(key);
      const tags = [...document.querySelectorAll(".is-kind")].filter((one) => key.startsWith(above(one.dataset.key)))
        .map((one) => one.querySelector("select").value).join("/");
      if (visited.has(`${key} ${tags}`)) continue;
      visited.add(`${key} ${tags}`);
      const after = await changed(() => move(line));
      const found = after === null ? ["nothing"] : differing(now, after);
      const owner = key.replace(/(\\.\\d+)+$/, "");
      const inner = found.filter((one) => one.startsWith(`${owner}.`));  // of a table that was switched on
      if (found.filter((one) => !inner.includes(one)).join() !== owner) wrong.push([key, tags, found]);
      if (inner.length) {
        const before = now;
        now = after;
        await sweep(row(key).parentElement);
        now = before;
      }
      if (after !== null) await changed(() => press("undo"));
    }
  };
  await sweep(document.getElementById("controls"));
  const done = new Set();
  for (;;) {
    const depth = ([key]) => key.split(".").length;
    const left = [...document.querySelectorAll(".is-kind")].flatMap((one) => [...one.querySelector("select").options]
      .map((option) => [one.dataset.key, option.value])).filter(([key, value]) => !done.has(`${key}=${value}`));
    const next = left.sort((one, other) => depth(other) - depth(one))[0];
    if (!next) break;
    const [key, value] = next;
    done.add(`${key}=${value}`);
    if (row(key).querySelector("select").value === value) continue;
    const after = await changed(() => put(row(key).querySelector("select"), value));
    if (after === null || !differing(now, after).every((one) => one.startsWith(above(key)))) wrong.push([key, value]);
    now = after;
    await sweep(row(key).parentElement);
  }
  window.fetch = ask;
  return { visited: [...visited].map((one) => one.split(" ")[0]), kinds: [...done], wrong };
})()"""


def expected_keys(definitions, table, path):
    """Dotted keys of all controls of a table, in all kinds; lists and what is either a name or a table are left out."""
    for key, node in definitions[table]["properties"].items():
        parts = [part["$ref"].rsplit("/", 1)[1] for part in node.get("anyOf", [node]) if "$ref" in part]
        plain = [part for part in node.get("anyOf", ()) if "$ref" not in part and part.get("type") != "null"]
        if key in ("model", "dist", "base", "sensors", "vary", "every") or (parts and plain):
            continue
        if parts:
            for part in parts:
                yield from expected_keys(definitions, part, f"{path}{key}.")
        elif node.get("type") != "array" or "prefixItems" in node or "enum" in node["items"]:
            yield f"{path}{key}"


def test_every_control_of_the_schema_changes_its_key_alone(shown):
    found = shown.evaluate(SWEEP)
    assert found["wrong"] == []
    missing = set(expected_keys(schema()["$defs"], "Scenario", "")) - set(found["visited"])
    assert missing == set()
    assert len(set(found["visited"])) > 200
    assert {"grab.model=mesh", "swing.model=dynamic", "swing.alpha.law.dist=rayleigh"} <= set(found["kinds"])


def test_two_scenes_are_edited_apart(shown, folder):
    shown.evaluate('put(document.getElementById("compare"), "other.toml")')
    shown.wait('view("b").dataset.small === "false"')
    shown.evaluate('document.querySelector("#which input[value=b]").click()')
    shown.evaluate('put(part("camera.beta_deg", "input[type=number]"), 9)')
    shown.wait('document.querySelector("#panel-truth")')
    assert scene(shown) == scenes.load(folder / "other.toml", {"camera.beta_deg": 9.0})
    shown.evaluate('document.querySelector("#which input[value=a]").click()')
    assert scene(shown) == scenes.load(folder / "yard.toml")


def test_sensors_and_what_varies_are_added_and_removed(shown, folder):
    before = scenes.load(folder / "yard.toml")
    act_and_wait(shown, 'put(row("swing.model").querySelector("select"), "dynamic");')
    act_and_wait(
        shown,
        """const add = [...document.querySelectorAll(".adding")].find((one) => one.querySelector("select"));
      add.querySelector("input").value = "imu0"; add.querySelector("button").click();""",
    )
    assert scene(shown).sensors["imu0"].mount == "camera"
    act_and_wait(
        shown,
        """put(part("clip.clip_frames", "input[type=number]"), 3);
      const add = document.querySelector("[aria-label=\\"Key that varies\\"]"); add.value = "weather.wetness";
      add.parentElement.querySelector("button").click();""",
    )
    assert list(scene(shown).vary) == ["weather.wetness"]
    act_and_wait(
        shown,
        """const name = document.querySelector("[aria-label=\\"Name of a new entry of every\\"]");
      name.value = "weather";
      name.parentElement.querySelector("button").click();
      put(part("every.weather", "input[type=number]"), 6);""",
    )
    assert scene(shown).every == {"weather": 6}
    act_and_wait(shown, 'document.querySelector("[aria-label=\\"Remove every.weather\\"]").click();')
    act_and_wait(shown, 'document.querySelector("[aria-label=\\"Remove vary.weather.wetness\\"]").click();')
    act_and_wait(shown, 'document.querySelector("[aria-label=\\"Remove sensors.imu0\\"]").click();')
    left = scene(shown)
    assert (left.vary, left.sensors) == (before.vary, before.sensors)


def test_a_slider_gives_small_frames_while_it_moves_and_the_full_one_when_it_rests(shown):
    seen = shown.evaluate("""(async () => {
      const sizes = [];
      new MutationObserver(() => sizes.push(view().dataset.small)).observe(view(), { attributeFilter: ["data-drawn"] });
      const slider = part("camera.roll_deg", "input[type=range]");
      for (let i = 0; sizes.length < 2; i++) {
        put(slider, i % 40, "input");
        await new Promise((done) => setTimeout(done, 30));
      }
      while (sizes.at(-1) !== "false") await new Promise((done) => setTimeout(done, 20));
      return sizes;
    })()""")
    assert seen[:-1] == ["true"] * (len(seen) - 1)
    assert len(seen) >= 3
    shown.evaluate('press("undo")')
    assert shown.evaluate('document.getElementById("undo").disabled')  # all of it was one step


def test_an_error_stands_at_its_key_and_goes_away(shown):
    shown.evaluate('put(part("light.sun_elevation_deg", "input[type=number]"), 500)')
    shown.wait("row('light.sun_elevation_deg').querySelector('.error:not([hidden])')")
    text = shown.evaluate("row('light.sun_elevation_deg').querySelector('.error').textContent")
    assert "90" in text
    assert shown.evaluate("row('light').open")
    shown.evaluate('put(part("light.sun_elevation_deg", "input[type=number]"), 50)')
    shown.wait("!document.querySelector('#controls .error:not([hidden])')")


def test_keys_are_found_by_name_and_help(shown):
    find = 'put(document.getElementById("search"), "{}", "input")'
    shown.evaluate(find.format("tilt azimuth"))
    visible = shown.evaluate("""[...document.querySelectorAll(".key:not([hidden])")]
      .filter((one) => one.offsetParent).map((one) => one.dataset.key)""")
    assert "camera.tilt_azimuth_deg" in visible
    assert len(visible) < 12
    shown.evaluate(find.format("no such key"))
    assert not shown.evaluate('document.getElementById("no-match").hidden')
    shown.evaluate(find.format(""))


def test_layers_are_switched_and_drawn(shown):
    for layer in ("box", "mask", "keypoints", "vertical", "principal", "angles"):
        at_first = shown.evaluate(f'document.querySelector("[data-layer={layer}]").checked')
        for on in (not at_first, at_first):
            shown.evaluate(f'document.querySelector("[data-layer={layer}]").click()')
            assert shown.evaluate(f'seen("{layer}")') == on, layer


def test_frames_play_beside_another_seed_and_the_instrument_measures(shown):
    shown.evaluate('put(document.getElementById("compare"), "another seed")')
    shown.wait('view("b").dataset.small === "false"')
    assert shown.evaluate(
        "view('a').querySelector('canvas').toDataURL() !== view('b').querySelector('canvas').toDataURL()"
    )
    shown.evaluate('press("play")')
    shown.wait('+view("a").dataset.frame > 2 && +view("b").dataset.frame > 2')
    shown.evaluate('if (document.getElementById("play").textContent === "Pause") press("play")')
    act_and_wait(shown)
    shown.evaluate('put(document.getElementById("compare"), "nothing"); press("tab-instrument")')
    shown.wait('+document.getElementById("panel-instrument").dataset.measured >= 9')
    assert "of 9 frames" in shown.evaluate('document.getElementById("panel-instrument").textContent')


def test_names_are_text_and_every_control_has_a_name(shown):
    assert shown.evaluate('document.getElementById("about").textContent') == HOSTILE
    assert shown.evaluate('document.querySelectorAll("h1 *, #about *, script:not([src]), img").length') == 0
    assert shown.evaluate(NAMELESS) == []
    ids = shown.evaluate('[...document.querySelectorAll("[id]")].map((one) => one.id)')
    assert len(ids) == len(set(ids))


@pytest.mark.parametrize("width", [1440, 1024, 390])
def test_the_page_fits(shown, width):
    shown.look(width, 900, dark=width == 1024)
    assert not shown.evaluate("document.documentElement.scrollWidth > innerWidth")
    shown.look(1440, 1000)


def test_a_scene_is_saved_and_its_command_shown(shown, folder):
    act_and_wait(shown, 'put(part("camera.beta_deg", "input[type=number]"), 4);')
    shown.evaluate('press("save"); document.getElementById("saving-path").value = "again.toml"; press("saving-go")')
    shown.wait('document.getElementById("saving-status").textContent.startsWith("Saved")')
    assert scenes.load(folder / "again.toml").camera.beta_deg == 4.0
    shown.evaluate('document.getElementById("saving").close(); press("copy")')
    shown.wait('document.getElementById("command").textContent.endsWith("--set camera.beta_deg=4.0")')
    assert shown.evaluate('document.getElementById("commanding").open')
    shown.evaluate('document.getElementById("commanding").close()')
