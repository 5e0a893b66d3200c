// The 3D view of the scene: a canvas, the controls of its camera, and the buttons below.

import { api, count, h, size } from "../lib/dom.js";
import { angleOf, between, fitted, matrixOf, neared, poseOf, rayOf, seenAt, surroundingsOf } from "./camera.js";
import { controls } from "./controls.js";
import { cropTools } from "./crop_tools.js";
import { frusta } from "./frusta.js";
import { renderer } from "./gl.js";
import { NEAR } from "./lines.js";
import { loading } from "./loading.js";
import { SceneError } from "./ply.js";
import { sceneTools } from "./tools.js";
import { savedPicture } from "./picture.js";
import { ruler } from "./ruler.js";
import { cameraWithin, matrixInWorld, worldOf } from "./world.js";

/** Most canvas pixels per CSS pixel; more cost time without visible gain. */
const FINEST = 2;
/** Flight from one photograph to the next, ms. */
const FLIGHT = 450;
/** Slower frames during movement are drawn coarser, ms. */
const SLOW = 70;
const COARSE = 0.5;
/** Delay from the last movement to a full-resolution frame, ms. */
const REST = 180;
/** A longer pause between frames does not measure their speed, ms. */
const PAUSE = 400;
/** Longest movement of a held key per frame, ms. */
const LONGEST_STEP = 100;
/** Starting distance before points, times the distance to the middle. */
const BACK = 1.7;
const KEYS = "Drag to turn; hold Shift or use the right button to pan. After a click, the wheel zooms, "
  + "W A S D walk, Q and E move down and up, and the arrow keys look around. Escape returns the wheel and the keys to the page.";
/** Shown above the lower edge of the picture until the first movement; the others for touch. */
const MOUSE = "Drag to turn, wheel to zoom, W A S D to walk";
const UNTOUCHED = "Tap to move through the scene";
const FINGERS = "One finger turns, two pan and zoom. Tap beside the picture to scroll the page.";
/** A degree, radians. */
const DEGREE = Math.PI / 180;
const NO_WEBGL = "This browser does not support WebGL 2, which the 3D view needs. Turn on hardware "
  + "acceleration in its settings, or use the pictures rendered by the server below.";
const LOST = "The graphics adapter dropped the picture, as can happen when it is overloaded or the "
  + "machine was asleep. Open the scene again.";
/** How to pick a point, after what it is for. */
const PICKING = "click its surface, or turn the view and press Enter to take what is in the middle "
  + "of the picture. Escape cancels.";
const TAPPING = "tap its surface. The same button cancels.";
const NOTHING = "There is no surface at that place";

/**
 * Opens the scene of a job in `place`. `name` is the job's, `scenes` are
 * `{ round, url, isDelivered }`, `first` is the initial one and `start` the name of the initial
 * camera, whose view has the best score if `isBest`. `headers` go with each request. `shaping` is
 * what the user draws there; without it there are no tools for that.
 * `ended(words)` is called when the view closes, with the reason if it closes by itself. Throws a
 * `SceneError` if the browser cannot draw it.
 */
export async function openScene(place, { job, headers, name, scenes, first, start, isBest, shaping, ended }) {
  const cameras = await api(`v1/jobs/${job}/artifacts/cameras.json`, { headers });
  const view = new View({ job, headers, name, isBest, shaping }, cameras, scenes, ended);
  place.replaceChildren(view.stage);
  // The canvas, its tools and its hint fit the window; they shall all be in it.
  view.stage.scrollIntoView({ block: "nearest" });
  view.begin(first, Math.max(0, cameras.findIndex(({ name }) => name === start)));
  return view;
}

/** Describes the content of a scene in a sentence. */
function contentOf({ isPoints }, content) {
  if (!isPoints) return `The scene has ${count(content.count, "Gaussian")}.`;
  const points = count(content.count, "sparse point");
  return content.isGuessed ? `${points}, estimated because the poses came without any.`
    : `${points}, used to place the cameras.`;
}

class View {
  pose = null;
  #chosen = -1;
  #flight = null;
  #asked = 0;
  #last = 0;
  #rest = 0;
  #isSlow = false;
  #isMoving = false;
  #source = null;
  #incoming = null;
  #sorted = "";
  #isSorting = false;
  #isGone = false;
  #aim = null;
  #words = "";

  constructor(of, cameras, scenes, ended) {
    this.job = of.job;
    this.shaping = of.shaping;
    this.headers = of.headers;
    this.name = of.name;
    this.world = worldOf(cameras);
    cameras = cameras.map((camera) => cameraWithin(camera, this.world));
    this.cameras = cameras;
    this.scenes = scenes;
    this.ended = ended;
    this.surroundings = surroundingsOf(cameras);
    this.canvas = h("canvas", {});
    this.drawer = renderer(this.canvas);
    if (!this.drawer) throw new SceneError(NO_WEBGL);
    this.lines = h("canvas", { class: "lines" });
    this.veil = h("div", { class: "veil", role: "status" });
    this.aimed = h("span", { class: "aim" });
    this.thumb = h("p", { class: "thumb" }, this.aimed, h("span", { class: "mouse" }, MOUSE), h("span", { class: "out" }, UNTOUCHED), h("span", { class: "in" }, FINGERS));
    this.frame = h("div", {
      class: "frame", tabIndex: 0, role: "application",
      "aria-label": "Scene in 3D: arrow keys look around, W A S D walk, Q and E move down and up",
    }, this.canvas, this.lines, this.veil, this.thumb);
    this.stage = h("div", { class: "stage" }, h("div", { class: "band" }, this.frame));
    this.crop = of.shaping && cropTools(of.shaping, this.surroundings, this.world, this.#ask);
    this.ruler = of.shaping
      && ruler(of.shaping, this.surroundings, this.world, this.#ask, () => this.wake());
    this.deaf = of.shaping?.heard(() => this.#shaped());
    const drawing = [this.crop, this.ruler].filter(Boolean);
    const further = {
      choices: drawing.map(({ choice }) => choice), rows: drawing.map(({ row }) => row),
    };
    this.tools = sceneTools(cameras, this.stage, of.isBest, further, {
      jump: (index) => this.jump(index),
      reset: () => this.jump(this.start),
      lines: () => this.wake(),
      lens: (degrees) => this.#see(degrees),
      exposure: this.drawer.exposes ? () => this.wake() : null,
      round: (scene) => this.load(scene),
      picture: () => this.save(),
      close: () => this.ended(""),
    });
    this.stage.append(this.tools.root);
    this.frusta = frusta(cameras, this.surroundings);
    this.controls = controls(this.frame, this);
    this.canvas.addEventListener("webglcontextlost", () => this.#isGone || this.ended(LOST));
    this.resizes = new ResizeObserver(() => this.#resize());
  }

  begin(scene, start) {
    this.start = start;
    this.#look(start);
    const pose = poseOf(this.k, this.surroundings);
    // The few points are best seen from behind the photographers, together with the cameras.
    if (scene.isPoints) this.#stand(neared(pose, this.surroundings, BACK), -1);
    else this.#stand(pose, start);
    this.resizes.observe(this.frame);
    this.load(scene);
    this.frame.focus({ preventScroll: true });
  }

  /** Updates the list of scenes. */
  update(scenes) {
    this.scenes = scenes;
    if (this.scene) this.tools.scenes(scenes, this.scene);
  }

  /** Shows another scene from the same camera. */
  async load(scene) {
    this.#incoming?.end();
    this.#busy(true);
    this.veil.textContent = this.#source ? "" : "Loading the scene…";
    const incoming = loading({ ...scene, headers: this.headers }, this.world, (received, total) => this.#progress(received, total));
    this.#incoming = incoming;
    try {
      const content = await incoming.whole;
      const row = matrixOf(this.pose)[2];
      const order = await incoming.sort(row);
      if (this.#isGone || this.#incoming !== incoming) return;
      this.drawer.load(content);
      this.drawer.sort(order);
      this.#source?.end();
      [this.#source, this.#incoming] = [incoming, null];
      [this.#sorted, this.#isSorting] = [row.join(), false];
      this.scene = scene;
      this.tools.scenes(this.scenes, scene);
      this.#words = `${matchMedia("(pointer: coarse)").matches ? "" : KEYS} ${contentOf(scene, content)}`.trim();
      if (!this.#aim) this.tools.say(this.#words);
      this.veil.textContent = "";
      this.wake();
    } catch (error) {
      if (!this.#isGone && this.#incoming === incoming) this.#refused(error, incoming);
    }
  }

  #refused(error, incoming) {
    incoming.end();
    this.#incoming = null;
    const words = error instanceof SceneError ? error.message : String(error);
    if (!this.#source) this.ended(`The scene cannot be shown. ${words}`);
    else {
      this.tools.scenes(this.scenes, this.scene);
      this.tools.say(`The selected scene cannot be shown. ${words}`);
      this.wake();
    }
  }

  #progress(received, total) {
    const share = total ? `${Math.round((100 * received) / total)} % of ${size(total)}`
      : size(received);
    const words = `Loading the scene: ${share}`;
    if (this.#source) this.tools.say(words);
    else this.veil.textContent = words;
  }

  /** Flies to a photograph's camera. */
  jump(index) {
    if (index < 0) return;
    const to = poseOf(this.cameras[index], this.surroundings);
    const isStill = matchMedia("(prefers-reduced-motion: reduce)").matches;
    this.#flight = isStill ? null : { from: this.pose, to, since: performance.now() };
    this.#look(index);
    this.#fit();
    this.#stand(isStill ? to : this.pose, index);
  }

  /** Uses the lens of a photograph's camera. */
  #look(index) {
    this.k = this.cameras[index];
    this.lens = angleOf(this.k);
    this.tools.lens(Math.round(this.lens / DEGREE));
  }

  /** Uses a field of view in degrees, or with null the camera's own. */
  #see(degrees) {
    this.lens = degrees === null ? angleOf(this.k) : degrees * DEGREE;
    this.tools.lens(Math.round(this.lens / DEGREE));
    this.#fit();
    this.wake();
  }

  speed = () => this.tools.speed();

  /** Moves to a pose, at the camera `chosen` or, with -1, at none. */
  #stand(pose, chosen) {
    this.pose = pose;
    this.#chosen = chosen;
    this.tools.at(chosen);
    this.wake();
  }

  /** For the controls: the user has moved. */
  moved(pose) {
    this.#flight = null;
    this.thumb.classList.add("known");
    this.#stand(pose, -1);
  }

  /** For the controls: a click picks a point if one is asked for, or flies to a camera's lines. */
  clicked(x, y) {
    const scale = this.canvas.width / this.frame.clientWidth;
    /** @type {[number, number]} */
    const place = [x * scale, y * scale];
    if (this.#aim) { this.#pick(place); return; }
    const index = this.tools.isOn() ? this.frusta.at(this.pose, this.shown, place, scale) : -1;
    if (index >= 0) this.jump(index);
  }

  /** For the controls: Enter picks what is in the middle. */
  entered() {
    if (this.#aim) this.#pick([this.canvas.width / 2, this.canvas.height / 2]);
  }

  /** For the controls: Escape ends picking. */
  escaped() {
    if (!this.#aim) return false;
    this.#took(null);
    return true;
  }

  /**
   * Asks the user to pick `what`, a point of a surface of the whole scene or, with `isCropped`, of
   * what is inside the crop. The promise is of a drawn point, or of `null` if it is given up, as by
   * asking for the same again.
   */
  #ask = (what, isCropped = false) => new Promise((took) => {
    const isSame = this.#aim?.what === what;
    if (this.#aim) this.#took(null);
    if (isSame) { took(null); return; }
    this.#aim = { took, isCropped, what };
    this.frame.classList.add("aiming");
    this.#point(what);
    this.frame.focus({ preventScroll: true });
    this.wake();
  });

  /** Says what is to be picked, in the picture and below it. */
  #point(words) {
    this.aimed.textContent = words;
    this.tools.say(`${words}: ${matchMedia("(pointer: coarse)").matches ? TAPPING : PICKING}`);
  }

  /** Looks for the surface at a pixel of the canvas. */
  async #pick(place) {
    if (!this.#source) return;
    const aim = this.#aim;
    const crop = aim.isCropped ? this.crop.drawn() : null;
    const point = await this.#source.meet({ ...rayOf(this.pose, this.shown, place), crop });
    if (this.#isGone || this.#aim !== aim) return;
    if (point) this.#took(point);
    else this.#point(`${NOTHING}. ${aim.what}`);
  }

  #took(point) {
    const { took } = this.#aim;
    this.#aim = null;
    this.frame.classList.remove("aiming");
    this.tools.say(this.#words);
    this.wake();
    took(point);
  }

  /** The user has drawn something, here or elsewhere. */
  #shaped() {
    this.crop.show();
    this.ruler.show();
    if (this.#aim && !this.#aim.isCropped && !this.crop.drawn()) this.#took(null);
    this.wake();
  }

  focal = () => (this.shown.fx * this.frame.clientWidth) / this.canvas.width;

  #resize() {
    const fine = Math.min(FINEST, devicePixelRatio);
    const side = (length) => Math.max(1, Math.round(length * fine));
    const [width, height] = [side(this.frame.clientWidth), side(this.frame.clientHeight)];
    if (this.canvas.width === width && this.canvas.height === height && this.shown) return;
    for (const canvas of [this.canvas, this.lines]) Object.assign(canvas, { width, height });
    this.#fit();
    // Draws at once, because resizing clears a canvas.
    this.#draw(1);
    this.wake();
  }

  #fit() {
    this.shown = fitted(seenAt(this.k, this.lens), this.canvas.width, this.canvas.height);
  }

  /** Schedules a frame. Nothing is drawn while nothing changes. */
  wake() {
    if (this.#isGone || this.#asked) return;
    this.#busy(true);
    this.#asked = requestAnimationFrame((time) => this.#step(time));
  }

  #step(time) {
    this.#asked = 0;
    clearTimeout(this.#rest);
    const passed = time - this.#last;
    if (this.#isMoving || passed < PAUSE) {
      this.#isSlow = passed > SLOW || (this.#isSlow && passed > SLOW / 3);
    }
    this.#last = time;
    const isHeld = this.controls.isHeld();
    if (isHeld) this.moved(this.controls.held(Math.min(LONGEST_STEP, passed) / 1000));
    if (this.#flight) this.#fly(time);
    this.#sort();
    if (!this.shown) return;
    this.#draw(this.#isSlow ? COARSE : 1);
    this.#isMoving = isHeld || this.#flight !== null;
    if (this.#isMoving) this.wake();
    else this.#rest = setTimeout(() => this.#settle(), REST);
  }

  #fly(time) {
    const { from, to, since } = this.#flight;
    const part = Math.min(1, Math.max(0, (time - since) / FLIGHT));
    this.pose = between(from, to, part * part * (3 - 2 * part));
    if (part === 1) this.#flight = null;
  }

  #settle() {
    if (this.#isGone || this.#isSorting || this.#asked) return;
    if (this.#isSlow) this.#draw(1);
    this.#busy(this.#incoming !== null);
  }

  /** Whether all of the scene is shown: without a crop, and while one is being placed. */
  #isWhole() {
    return !this.crop?.drawn() || (this.#aim !== null && !this.#aim.isCropped);
  }

  #draw(part) {
    const crop = this.#isWhole() ? null : this.crop.drawn();
    this.drawer.draw(this.pose, this.shown, part, this.tools.ev(), crop);
    const context = this.lines.getContext("2d");
    const { width, height } = this.lines;
    const near = NEAR * this.surroundings.radius;
    context.clearRect(0, 0, width, height);
    if (this.tools.isOn()) this.frusta.draw(context, this.pose, this.shown, this.#chosen);
    for (const drawn of [this.crop, this.ruler]) drawn?.draw(context, this.pose, this.shown, near);
    this.lines.hidden = !this.tools.isOn() && !this.crop?.drawn() && !this.ruler?.isShown();
  }

  /** Requests the blending order for the current pose, one request at a time. */
  #sort() {
    const row = matrixOf(this.pose)[2];
    if (!this.#source || this.#isSorting || row.join() === this.#sorted) return;
    const source = this.#source;
    this.#isSorting = true;
    source.sort(row).then((order) => {
      if (this.#isGone || this.#source !== source) return;
      this.drawer.sort(order);
      [this.#isSorting, this.#sorted] = [false, row.join()];
      this.wake();
    });
  }

  #busy(isBusy) {
    this.frame.setAttribute("aria-busy", String(isBusy));
  }

  /** The file name of a picture: job, view and round. */
  #named() {
    const view = this.#chosen >= 0 ? this.cameras[this.#chosen].name : "free view";
    const name = `${this.name} ${view} round ${this.scene.round}`;
    return `${name.replace(/[^\p{L}\p{N}_.]+/gu, "-").replace(/^[-.]+/, "")}.png`;
  }

  /** Saves this view as rendered by the server. */
  async save() {
    try {
      const crop = this.#isWhole() ? null : this.shaping.now.crop;
      await savedPicture(this.job, this.#named(), this.scene, matrixInWorld(this.pose, this.world), this.shown, this.tools.ev(), crop);
    } catch (error) {
      this.tools.say(`The picture could not be saved. ${error.message}`);
    }
  }

  /** Releases everything. */
  leave() {
    this.#isGone = true;
    this.deaf?.();
    this.#aim?.took(null);
    cancelAnimationFrame(this.#asked);
    clearTimeout(this.#rest);
    this.resizes.disconnect();
    this.controls.leave();
    this.#incoming?.end();
    this.#source?.end();
    this.drawer.free();
    this.stage.remove();
  }
}
