// A run while it works: how far it is, its frames and mattes, and when there are new poses or a new
// splat.
import { make } from "./panel.js";

const EVERY = 1000; // ms
const EVERY_AT_END = 5000;
const MOST_FAILURES = 3;

export class Live {
  constructor({ newScene, newSplat, goTo }) {
    Object.assign(this, { newScene, newSplat, goTo, seen: { poses: 0, splat: 0, frames: -1, mattes: 0 }, names: new Map(), failures: 0 });
    document.body.classList.add("watched");
    const head = document.getElementById("head");
    this.stage = make("div", { id: "stage" });
    this.bar = make("div", { id: "bar" }, make("i"));
    this.verdict = make("div", { id: "verdict", hidden: true });
    head.append(this.stage, this.bar, this.verdict);
    this.strip = document.getElementById("strip");
    this.cells = [];
    this.poll();
  }

  async poll() {
    let pause = EVERY;
    try {
      const answer = await fetch("status.json");
      if (!answer.ok) throw new Error(answer.statusText);
      const status = await answer.json();
      this.failures = 0;
      this.status = status;
      this.show(status);
      if (status.poses !== this.seen.poses) {
        this.seen.poses = status.poses;
        const scene = await (await fetch("scene.json")).json();
        this.mark(scene.cameras);
        this.newScene(scene);
      }
      if (status.splat !== this.seen.splat && status.splat > 0) {
        this.seen.splat = status.splat;
        await this.newSplat(`splat.spz?v=${status.splat}`);
      }
      if (status.end) pause = EVERY_AT_END;
    } catch {
      this.failures += 1;
    }
    if (this.failures >= MOST_FAILURES) {
      if (!this.status?.end) this.stage.textContent = "The run has stopped; the terminal says why.";
      this.bar.hidden = true;
      return;
    }
    setTimeout(() => this.poll(), pause);
  }

  show(status) {
    const { place, what, done, total, detail } = status;
    const amount = total > 0 ? ` ${done} of ${total}` : done > 0 ? ` ${done}` : "";
    if (status.end) {
      this.stage.hidden = this.bar.hidden = true;
      this.verdict.hidden = false;
      this.verdict.className = status.end.level;
      this.verdict.replaceChildren(make("b", { textContent: status.end.words }), ...status.end.reasons.map((r) => make("small", { textContent: r })));
    } else {
      const stage = place.number > 0 ? `stage ${place.number} of ${place.of} · ` : "";
      this.stage.replaceChildren(stage, make("b", { textContent: what || "starting" }), amount, detail ? ` · ${detail}` : "");
      this.bar.className = total > 0 ? "" : "busy";
      this.bar.firstChild.style.width = total > 0 ? `${(100 * done) / total}%` : "";
    }
    if (status.report) this.linkReport();
    this.showFrames(status);
  }

  linkReport() {
    if (document.getElementById("report")) return;
    document.getElementById("head").append(make("a", { id: "report", href: "report.html", target: "_blank", textContent: "report" }));
  }

  showFrames({ frames, frames_version: version, mattes }) {
    if (version !== this.version) this.cells = [];
    if (version !== this.version || frames < this.cells.length) this.strip.replaceChildren();
    this.version = version;
    this.strip.hidden = frames === 0;
    while (this.cells.length < frames) {
      const index = this.cells.length;
      const photo = this.picture("frame", index, 0);
      const cell = make("figure", { title: `frame ${index + 1}` }, photo);
      cell.onclick = () => { if (cell.camera !== undefined) this.goTo(cell.camera); };
      this.cells.push(cell);
      this.strip.append(cell);
    }
    if (mattes > this.seen.mattes || (mattes > 0 && this.matted !== this.cells.length)) {
      this.seen.mattes = mattes;
      this.matted = this.cells.length;
      this.cells.forEach((cell, index) => { if (cell.children.length < 2) cell.append(this.picture("matte", index, mattes)); });
    }
    if (this.scene) this.mark(this.scene);
  }

  // A picture that is not there yet is left out until the next time.
  picture(kind, index, version) {
    const image = make("img", { alt: kind === "matte" ? "the object, cut out" : "a frame", loading: "lazy", src: `${kind}/${index}?v=${this.version}.${version}` });
    image.onerror = () => {
      if (kind === "matte") image.remove();
      else setTimeout(() => { image.src = `${kind}/${index}?v=${this.version}.${Date.now()}`; }, 2000);
    };
    return image;
  }

  // Which frames have a pose.
  mark(cameras) {
    this.scene = cameras;
    this.cells.forEach((cell) => { cell.className = ""; cell.camera = undefined; });
    cameras.forEach((view, i) => {
      const cell = this.cells[view.frame];
      if (cell) Object.assign(cell, { className: "posed", camera: i });
    });
  }
}
