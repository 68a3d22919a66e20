// The documents of a replay: fetched from the server, or read out of this page where it is a file of its own.

const HEAD_WORDS = 5;
// Rows are not blended over a hole of more than this many strides.
const HOLE = 3;

const here = () => location.pathname.replace(/\/$/, "");

// A file of the episode at an address.
export async function bytesOf(address, name, read = () => {}) {
  const block = document.getElementById(`block-${name}`);
  if (block) {
    return unpacked(block);
  }
  const answer = await fetch(`${address}/${name}`);
  if (!answer.ok) throw new Error(await answer.text());
  if (!answer.body) return answer.arrayBuffer();
  const parts = [];
  for (let reader = answer.body.getReader(); ; ) {
    const { done, value } = await reader.read();
    if (done) break;
    parts.push(value);
    read(value.length);
  }
  return new Blob(parts).arrayBuffer();
}

// The bytes of a block of this page, which are compressed.
async function unpacked(block) {
  const text = atob(block.textContent.trim());
  const bytes = new Uint8Array(text.length);
  for (let i = 0; i < text.length; i += 1) bytes[i] = text.charCodeAt(i);
  return new Response(new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"))).arrayBuffer();
}

// The replay of the episode at an address; that of this page without one. `loading` hears which share has arrived.
export async function load(address = here(), loading = () => {}) {
  loading(0);
  const text = new TextDecoder().decode(await bytesOf(address, "document.json"));
  const doc = JSON.parse(text);
  const whole = meshBytes(doc.stage) + trackBytes(doc.track);
  let arrived = 0;
  const read = (bytes) => {
    arrived += bytes;
    loading(Math.min(arrived / whole, 0.99));
  };
  const [meshes, track] = await Promise.all([shapesOf(address, doc.stage, read), bytesOf(address, "track.bin", read)]);
  loading(1);
  return { doc, meshes, track: new Track(doc.track, track) };
}

export function isFile() {
  return document.getElementById("block-document.json") !== null;
}

const meshBytes = ({ vertices, indices }) => 4 * (6 * vertices + indices);
const trackBytes = ({ rows, kept, width }) => 4 * (HEAD_WORDS + 3 * rows + kept + kept * width);

// Whole numbers in rows of `columns`, out of bytes that hold them column by column: each as its change, whose sign is the lowest bit,
// and first the lowest bytes of all.
export function unplaned(bytes, columns) {
  const count = bytes.length / 4;
  const numbers = new Int32Array(count);
  const rows = count / columns;
  for (let column = 0, at = 0; column < columns; column += 1) {
    let value = 0;
    for (let row = 0; row < rows; row += 1, at += 1) {
      const change = bytes[at] | (bytes[at + count] << 8) | (bytes[at + 2 * count] << 16) | (bytes[at + 3 * count] << 24);
      value = (value + ((change >>> 1) ^ -(change & 1))) | 0;
      numbers[row * columns + column] = value;
    }
  }
  return numbers;
}

// The shapes by their digests, which the browser keeps for other episodes; of this episode alone where the server has forgotten
// them.
async function shapesOf(address, stage, read) {
  if (isFile()) return readMeshes(stage, woven(await bytesOf(address, "meshes.bin")));
  try {
    const buffers = await Promise.all(stage.blocks.map(({ digest }) => bytesOf("/shapes", digest, read)));
    const parts = stage.blocks.map((block, index) => readMeshes(block, buffers[index]));
    const join = (Kind, name) => {
      const joined = new Kind(parts.reduce((length, part) => length + part[name].length, 0));
      parts.reduce((at, part) => (joined.set(part[name], at), at + part[name].length), 0);
      return joined;
    };
    return { positions: join(Float32Array, "positions"), normals: join(Float32Array, "normals"), indices: join(Uint32Array, "indices") };
  } catch {
    return readMeshes(stage, await bytesOf(address, "meshes.bin", read));
  }
}

// Numbers of four bytes, out of the first bytes of all, then the second ones, and so on.
export function woven(buffer) {
  const [from, to] = [new Uint8Array(buffer), new Uint8Array(buffer.byteLength)];
  const count = from.length / 4;
  for (let i = 0; i < from.length; i += 1) to[4 * (i % count) + Math.floor(i / count)] = from[i];
  return to.buffer;
}

function readMeshes(stage, buffer) {
  const numbers = 3 * stage.vertices;
  if (buffer.byteLength !== meshBytes(stage)) throw new Error("The shapes have another length than announced.");
  return {
    positions: new Float32Array(buffer, 0, numbers),
    normals: new Float32Array(buffer, 4 * numbers, numbers),
    indices: new Uint32Array(buffer, 8 * numbers, stage.indices),
  };
}

// The rows. A place in time is a number of control steps, which need not be whole.
export class Track {
  constructor(info, buffer) {
    const head = new Uint32Array(buffer, 0, HEAD_WORDS);
    const [, version, rows, kept, width] = head;
    if (version !== 2 || rows !== info.rows || kept !== info.kept || width !== info.width || buffer.byteLength !== trackBytes(info)) {
      throw new Error("The rows do not fit their description.");
    }
    let at = 4 * HEAD_WORDS;
    const take = (Kind, count) => {
      const list = new Kind(buffer, at, count);
      at += 4 * count;
      return list;
    };
    this.steps = take(Uint32Array, rows);
    this.flags = take(Uint32Array, rows);
    this.handForce = take(Float32Array, rows);
    this.keptSteps = take(Uint32Array, kept);
    this.dt = info.control_dt;
    this.pose = info.pose;
    this.stride = info.stride;
    [this.first, this.last] = info.span;
    this.forces = info.forces;
    this.expand(info, unplaned(new Uint8Array(buffer, at), width));
  }

  // Of each kept row: a pose for each frame, then the forces; and the angles. Links follow from pelvis and angles.
  expand({ links, joints, grid, pose, kept, width, forces }, stored) {
    const [from, to] = [pose + joints.length, width - 3 * forces.length];
    this.forcesAt = pose * links.length + to - from;
    this.width = this.forcesAt + 3 * forces.length;
    this.numbers = new Float32Array(kept * this.width);
    this.angles = new Float32Array(kept * joints.length);
    const world = new Float64Array(pose * links.length);
    for (let row = 0; row < kept; row += 1) {
      const [source, target] = [row * width, row * this.width];
      for (let i = 0; i < joints.length; i += 1) this.angles[row * joints.length + i] = stored[source + pose + i] * grid.pose;
      links.forEach((link, index) => {
        if (link.parent === null) for (let i = 0; i < pose; i += 1) world[pose * index + i] = stored[source + i] * grid.pose;
        else place(world, pose * index, pose * link.parent, link, link.joint === null ? 0 : stored[source + pose + link.joint] * grid.pose);
      });
      this.numbers.set(world, target);
      for (let i = from; i < to; i += 1) this.numbers[target + world.length + i - from] = stored[source + i] * grid.pose;
      for (let i = to; i < width; i += 1) this.numbers[target + this.forcesAt + i - to] = stored[source + i] * grid.force;
    }
  }

  // Index of the row at a step, or of the last one before it.
  row(step) {
    return lastUpTo(this.steps, step);
  }

  // The kept rows around a step, and how far it is from one to the other.
  around(step) {
    const from = lastUpTo(this.keptSteps, step);
    const to = Math.min(from + 1, this.keptSteps.length - 1);
    const distance = this.keptSteps[to] - this.keptSteps[from];
    const blend = distance > 0 && distance <= HOLE * this.stride ? (step - this.keptSteps[from]) / distance : 0;
    return { from, to, blend: Math.min(Math.max(blend, 0), 1) };
  }

  // Position and quaternion (x, y, z, w) of a frame, written into two lists.
  poseAt({ from, to, blend }, frame, position, quaternion) {
    const a = from * this.width + frame * this.pose;
    const b = to * this.width + frame * this.pose;
    const n = this.numbers;
    for (let i = 0; i < 3; i += 1) position[i] = n[a + i] + blend * (n[b + i] - n[a + i]);
    let dot = 0;
    for (let i = 3; i < 7; i += 1) dot += n[a + i] * n[b + i];
    const sign = dot < 0 ? -1 : 1;
    let length = 0;
    for (let i = 0; i < 4; i += 1) {
      // w comes first in the rows and last here.
      const at = 3 + ((i + 1) % 4);
      quaternion[i] = n[a + at] + blend * (sign * n[b + at] - n[a + at]);
      length += quaternion[i] * quaternion[i];
    }
    length = Math.sqrt(length) || 1;
    for (let i = 0; i < 4; i += 1) quaternion[i] /= length;
  }

  // A force in the kept row at a step, N.
  force({ from }, index) {
    const at = from * this.width + this.forcesAt + 3 * index;
    return this.numbers.subarray(at, at + 3);
  }
}

// Writes the pose of a link into a list of poses, from that of its parent in there. Quaternions are w first.
function place(world, to, from, { at, axis }, angle) {
  const [w, x, y, z] = [world[from + 3], world[from + 4], world[from + 5], world[from + 6]];
  // Twice the cross product of the parent's turn and the offset.
  const dx = 2 * (y * at[2] - z * at[1]);
  const dy = 2 * (z * at[0] - x * at[2]);
  const dz = 2 * (x * at[1] - y * at[0]);
  world[to] = world[from] + at[0] + w * dx + y * dz - z * dy;
  world[to + 1] = world[from + 1] + at[1] + w * dy + z * dx - x * dz;
  world[to + 2] = world[from + 2] + at[2] + w * dz + x * dy - y * dx;
  times(world, to + 3, w, x, y, z, at[3], at[4], at[5], at[6]);
  if (angle === 0) return;
  const sine = Math.sin(angle / 2);
  const [qw, qx, qy, qz] = [world[to + 3], world[to + 4], world[to + 5], world[to + 6]];
  times(world, to + 3, qw, qx, qy, qz, Math.cos(angle / 2), axis[0] * sine, axis[1] * sine, axis[2] * sine);
}

// Writes the product of two quaternions.
function times(list, to, aw, ax, ay, az, bw, bx, by, bz) {
  list[to] = aw * bw - ax * bx - ay * by - az * bz;
  list[to + 1] = aw * bx + ax * bw + ay * bz - az * by;
  list[to + 2] = aw * by - ax * bz + ay * bw + az * bx;
  list[to + 3] = aw * bz + ax * by - ay * bx + az * bw;
}

// Index of the last of a rising list that is not beyond a value.
export function lastUpTo(sorted, value) {
  let [low, high] = [0, sorted.length];
  while (low < high) {
    const middle = (low + high) >> 1;
    if (sorted[middle] <= value) low = middle + 1;
    else high = middle;
  }
  return Math.max(low - 1, 0);
}
