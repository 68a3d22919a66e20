// The room, and the robot's state in it as it arrives.

const POSE = 7;
const GOALS = 2;

export async function loadRoom(token) {
  const get = async (name) => {
    const answer = await fetch(`/${name}?token=${encodeURIComponent(token)}`);
    if (!answer.ok) throw new Error(await answer.text());
    return answer;
  };
  const [doc, buffer] = await Promise.all([
    get("document.json").then((answer) => answer.json()),
    get("meshes.bin").then((answer) => answer.arrayBuffer()),
  ]);
  const { vertices, indices } = doc.stage;
  if (buffer.byteLength !== 4 * (6 * vertices + indices)) throw new Error("The shapes have another length than announced.");
  const meshes = {
    positions: new Float32Array(buffer, 0, 3 * vertices),
    normals: new Float32Array(buffer, 12 * vertices, 3 * vertices),
    indices: new Uint32Array(buffer, 24 * vertices, indices),
  };
  return { doc, meshes };
}

// The newest state, with what the picture asks of a replay's rows.
export class Live {
  constructor(doc) {
    this.doc = doc;
    this.frames = doc.stage.frames.length;
    this.first = 0;
    this.forces = [];
    this.poses = new Float32Array(POSE * (this.frames + GOALS));
    for (let frame = 0; frame < this.frames + GOALS; frame += 1) this.poses[POSE * frame + 3] = 1;
    this.state = null;
  }

  // Takes a state; false if it is not one of this room.
  take(buffer) {
    const { head_bytes: head, criteria } = this.doc;
    if (buffer.byteLength !== head + 4 * this.poses.length) return false;
    const view = new DataView(buffer);
    if (view.getUint32(0, true) !== 0x56544c46) return false;
    const [step, bits, flags] = [4, 8, 12].map((at) => view.getUint32(at, true));
    const number = (index) => view.getFloat32(24 + 4 * index, true);
    this.state = {
      step,
      criteria: criteria.map((_, index) => ((bits >>> index) & 1) === 1),
      frozen: (flags & 1) !== 0,
      follows: [(flags & 2) !== 0, (flags & 4) !== 0],
      freshSeated: (flags & 16) !== 0,
      chosen: (flags & 128) !== 0 ? 0 : (flags & 256) !== 0 ? 1 : null,
      closes: [(flags & 512) !== 0, (flags & 1024) !== 0],
      wanted: [(flags & 32) !== 0, (flags & 64) !== 0],
      echo: view.getFloat64(16, true),
      age: number(0),
      answer: number(1),
      progress: number(2),
      force: [number(3), number(4)],
      velocity: [number(5), number(6), number(7)],
      height: number(8),
    };
    this.poses = new Float32Array(buffer, head);
    return true;
  }

  around() {
    return 0;
  }

  poseAt(_, frame, position, quaternion) {
    const at = POSE * frame;
    for (let i = 0; i < 3; i += 1) position[i] = this.poses[at + i];
    // w comes first in a state and last here.
    for (let i = 0; i < 4; i += 1) quaternion[i] = this.poses[at + 3 + ((i + 1) % 4)];
  }

  // Where a hand is wanted: 0 is the left one.
  goalAt(side, position, quaternion) {
    this.poseAt(0, this.frames + side, position, quaternion);
  }

  force() {
    return [0, 0, 0];
  }
}
