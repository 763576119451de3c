// The panel: which camera, what is shown, how it looks, what is cut away.
export function make(tag, properties = {}, ...children) {
  const element = Object.assign(document.createElement(tag), properties);
  element.append(...children);
  return element;
}

const button = (text, title, onclick, className = "") => make("button", { textContent: text, title, onclick, className });
const named = (name, ...inputs) => make("label", {}, make("span", { textContent: name }), ...inputs);

export function slider(title, min, max, value, act, step = 0.01) {
  const input = make("input", { type: "range", min, max, step, value, title });
  input.oninput = () => act(Number(input.value));
  return input;
}

export function buildPanel(act) {
  const panel = document.getElementById("panel");
  const select = make("select", { title: "Input camera" });
  select.onchange = () => (Number(select.value) < 0 ? act.reset() : act.view(Number(select.value)));
  const step = (by) => act.view(Number(select.value) < 0 ? 0 : Number(select.value) + by);
  const toggle = (name, on) => {
    const box = make("input", { type: "checkbox", checked: on, onchange: () => act.toggle(name, box.checked) });
    box.dataset.part = name;
    return make("label", { className: "check" }, box, name);
  };
  const background = make("select", { title: "Background" });
  for (const [name, colour] of [["black", 0x000000], ["grey", 0x808080], ["white", 0xffffff]]) {
    background.append(make("option", { value: colour, textContent: name }));
  }
  background.onchange = () => act.background(Number(background.value));
  act.opacity(0);
  const section = (title, ...children) => make("section", {}, make("h2", { textContent: title }), ...children);
  panel.append(
    section("Input camera",
      make("div", { className: "row" }, button("◀", "Previous camera", () => step(-1)), select, button("▶", "Next camera", () => step(1))),
      named("photo", slider("Photo over the splat", 0, 1, 0, act.opacity))),
    section("Show", make("div", { className: "grid" }, ...["splat", "points", "cameras", "depth"].map((name) => toggle(name, name === "splat")), toggle("turn", false))),
    section("Look", named("exposure", slider("Exposure, stops", -3, 3, 0, act.exposure, 0.05)), named("background", background)),
    ...(act.jointControls.length ? [section("Parts", ...act.jointControls)] : []),
    section("Cut", ...act.cutControls),
    make("section", {},
      make("div", { className: "grid" }, button("reset", "Back to the start", act.reset), button("screenshot", "Save a PNG", act.screenshot), button("full screen", "Full screen, and back", act.fullScreen)),
      make("small", { textContent: "drag: orbit · right drag or two fingers: pan · wheel or pinch: zoom · WASD QE: fly" })),
  );
  const menu = document.getElementById("menu");
  const open = (on) => { panel.hidden = !on; menu.setAttribute("aria-expanded", on); menu.textContent = on ? "✕" : "☰"; };
  menu.onclick = () => open(panel.hidden);
  open(window.innerWidth > 900);
  return {
    showView: (i) => { select.value = i; },
    showPart: (name, on) => { panel.querySelector(`input[data-part=${name}]`).checked = on; },
    // The first of all is what the page opens with.
    setCameras: (cameras, shown) => {
      select.replaceChildren(make("option", { value: -1, textContent: "free view" }));
      cameras.forEach((view, i) => select.append(make("option", { value: i, textContent: view.name })));
      select.value = shown;
    },
  };
}
