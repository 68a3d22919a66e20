// The robot's view next to the scene: the head camera's pictures, where the episode has them.

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

export class Pictures {
  constructor(root, track, address) {
    this.track = track;
    this.step = track.first;
    this.steps = [];
    this.drawn = null;
    this.canvas = element("canvas", {});
    this.canvas.setAttribute("role", "img");
    this.canvas.setAttribute("aria-label", "What the head camera sees");
    this.said = element("figcaption", {}, "Head camera: loading");
    root.append(element("figure", { className: "seen" }, this.canvas, this.said));
    this.load(address).catch((error) => {
      this.said.textContent = `The head camera's pictures cannot be shown: ${error.message}`;
    });
  }

  async load(address) {
    const buffer = await bytesOf(address, "pictures.bin");
    const view = new DataView(buffer);
    const steps = [];
    this.blobs = [];
    for (let at = 0; at < buffer.byteLength; ) {
      const length = view.getUint32(at + 4, true);
      steps.push(view.getUint32(at, true));
      this.blobs.push(new Blob([new Uint8Array(buffer, at + 8, length)], { type: "image/png" }));
      at += 8 + length;
    }
    this.steps = steps;
    await this.show(this.step);
  }

  // Shows the last picture up to a step. While one is unpacked, only the newest wish is kept.
  async show(step) {
    this.step = step;
    if (this.steps.length === 0 || this.isBusy) return;
    const index = lastUpTo(this.steps, step);
    if (index === this.drawn) return;
    this.isBusy = true;
    const moment = seconds(this.steps[index], this.track.dt);
    try {
      const picture = await unpacked(this.blobs[index]);
      [this.canvas.width, this.canvas.height] = [picture.width, picture.height];
      this.canvas.getContext("2d").drawImage(picture, 0, 0);
      this.said.textContent = `Head camera at ${moment}`;
    } catch {
      this.said.textContent = `Head camera: the picture at ${moment} is damaged`;
    }
    this.drawn = index;
    this.isBusy = false;
    await this.show(this.step);
  }
}
