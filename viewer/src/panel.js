// The panel: which camera, what is shown, the photo's opacity, a screenshot.
export function buildPanel(data, act) {
  const panel = document.getElementById("panel");
  const make = (tag, properties = {}, ...children) => {
    const element = Object.assign(document.createElement(tag), properties);
    element.append(...children);
    return element;
  };
  const button = (text, title, onclick) => make("button", { textContent: text, title, onclick });
  const select = make("select", { title: "Input camera" });
  select.append(make("option", { value: -1, textContent: "free view" }));
  data.cameras.forEach((view, i) => select.append(make("option", { value: i, textContent: view.name })));
  select.onchange = () => (Number(select.value) < 0 ? act.reset() : act.view(Number(select.value)));
  const step = (by) => act.view(Number(select.value) < 0 ? 0 : Number(select.value) + by);
  const toggle = (name, text, on) => {
    const box = make("input", { type: "checkbox", checked: on, onchange: () => act.toggle(name, box.checked) });
    box.dataset.part = name;
    return make("label", {}, box, text);
  };
  const opacity = make("input", { type: "range", min: 0, max: 1, step: 0.01, value: 0, title: "Photo over the splat" });
  opacity.oninput = () => act.opacity(opacity.value);
  act.opacity(0);
  const slider = (title, min, max, act) => {
    const input = make("input", { type: "range", min, max, step: 0.05, value: 0, title });
    input.oninput = () => act(Number(input.value));
    return input;
  };
  const background = make("select", { title: "Background" });
  for (const [name, colour] of [["black", 0x000000], ["grey", 0x808080], ["white", 0xffffff]]) {
    background.append(make("option", { value: colour, textContent: name }));
  }
  background.onchange = () => act.background(Number(background.value));
  panel.append(
    make("div", {}, button("◀", "Previous camera", () => step(-1)), select, button("▶", "Next camera", () => step(1))),
    make("div", {}, make("label", {}, "photo ", opacity)),
    make("div", {}, toggle("splat", "splat", true), toggle("points", "points", false), toggle("cameras", "cameras", false), toggle("depth", "depth", false)),
    make("div", {}, make("label", {}, "exposure ", slider("Exposure, stops", -3, 3, act.exposure)), make("label", {}, "on ", background)),
    make("div", {}, toggle("turn", "turn", false), button("full screen", "Full screen, and back", act.fullScreen)),
    make("div", {}, button("reset", "Back to the start", act.reset), button("screenshot", "Save a PNG", act.screenshot)),
    make("small", { textContent: "drag: orbit · right drag: pan · wheel: zoom · WASD QE: fly" }),
  );
  return { showView: (i) => { select.value = i; } };
}
