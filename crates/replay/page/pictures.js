// Pictures of the robot's cameras next to the scene, where the episode has them.

import { bytesOf, lastUpTo } from "./data.js";
import { element, seconds } from "./words.js";

// A picture that a canvas can draw, also where there is no createImageBitmap.
async function unpacked(blob) {
  if (typeof createImageBitmap === "function") return createImageBitmap(blob);
  const ended = (one, begin) =>
    new Promise((done, failed) => {
      [one.onload, one.onerror] = [done, failed];
      begin();
    });
  const [reader, image] = [new FileReader(), new Image()];
  await ended(reader, () => reader.readAsDataURL(blob));
  // The page's rules allow no other address of a picture.
  await ended(image, () => (image.src = reader.result));
  return image;
}

const NAMES = {
  camera: "Head camera",
  chest_camera: "Chest camera",
  left_wrist_camera: "Left wrist",
  right_wrist_camera: "Right wrist",
  depth: "Head depth",
  chest_depth: "Chest depth",
  segmentation: "Head labels",
  chest_segmentation: "Chest labels",
};

// The pictures of one sensor.
class View {
  constructor(name, dt) {
    this.name = name;
    this.dt = dt;
    this.steps = [];
    this.blobs = [];
    this.drawn = null;
    this.canvas = element("canvas", {});
    this.canvas.setAttribute("role", "img");
    this.canvas.setAttribute("aria-label", name);
    this.said = element("figcaption", {}, `${name}: loading`);
    this.figure = element("figure", {}, this.canvas, this.said);
  }

  // Shows the last picture up to a step. While one is unpacked, only the newest wish is kept.
  async show(step) {
    this.step = step;
    if (this.steps.length === 0 || this.isBusy) return;
    const index = lastUpTo(this.steps, step);
    if (index === this.drawn) return;
    this.isBusy = true;
    const moment = seconds(this.steps[index], this.dt);
    try {
      const picture = await unpacked(this.blobs[index]);
      [this.canvas.width, this.canvas.height] = [picture.width, picture.height];
      this.canvas.getContext("2d").drawImage(picture, 0, 0);
      this.said.textContent = `${this.name} at ${moment}`;
    } catch {
      this.said.textContent = `${this.name}: the picture at ${moment} is damaged`;
    }
    this.drawn = index;
    this.isBusy = false;
    await this.show(this.step);
  }
}

export class Pictures {
  // `sensors` are those of the document.
  constructor(root, track, address, sensors) {
    this.step = track.first;
    this.counts = sensors.map(({ count }) => count);
    this.views = sensors.map(({ sensor }) => new View(NAMES[sensor] ?? sensor, track.dt));
    root.append(element("div", { className: "seen" }, ...this.views.map((view) => view.figure)));
    this.load(address).catch((error) => {
      for (const view of this.views) view.said.textContent = `${view.name}: its pictures cannot be shown: ${error.message}`;
    });
  }

  async load(address) {
    const buffer = await bytesOf(address, "pictures.bin");
    const bytes = new DataView(buffer);
    let at = 0;
    this.views.forEach((view, place) => {
      for (let left = this.counts[place]; left > 0; left -= 1) {
        const length = bytes.getUint32(at + 4, true);
        view.steps.push(bytes.getUint32(at, true));
        view.blobs.push(new Blob([new Uint8Array(buffer, at + 8, length)], { type: "image/png" }));
        at += 8 + length;
      }
    });
    await this.show(this.step);
  }

  async show(step) {
    this.step = step;
    await Promise.all(this.views.map((view) => view.show(step)));
  }
}
