// Numbers behind the gate's conditions, from the poses of a state: `src/measures.rs` says which.

const position = [0, 0, 0];
const quaternion = [0, 0, 0, 1];

// A number and its limit in words, such as `0.75 of 0.63 m`.
export function numberOf({ kind, limit, frame, fixed, half }, live) {
  live.poseAt(0, 0, position, quaternion);
  const [x, y] = position;
  const [i, j, k, w] = quaternion;
  const degrees = (angle) => `${Math.round((180 / Math.PI) * angle)}`;
  if (kind === "tilt") return `${degrees(Math.acos(Math.max(-1, 1 - 2 * (i * i + j * j))))} of ${degrees(limit)}\u00b0`;
  const heading = Math.atan2(2 * (w * k + i * j), 1 - 2 * (j * j + k * k));
  let [toX, toY, turn] = fixed;
  if (frame !== null) {
    live.poseAt(0, frame, position, quaternion);
    [toX, toY, turn] = [position[0], position[1], 0];
  }
  const [dx, dy] = [toX - x, toY - y];
  if (kind === "bearing") {
    const angle = Math.atan2(dy, dx) - heading;
    return `${degrees(Math.abs(Math.atan2(Math.sin(angle), Math.cos(angle))))} of ${degrees(limit)}\u00b0`;
  }
  const along = Math.abs(dx * Math.cos(turn) + dy * Math.sin(turn)) - half[0];
  const across = Math.abs(dy * Math.cos(turn) - dx * Math.sin(turn)) - half[1];
  return `${Math.hypot(Math.max(along, 0), Math.max(across, 0)).toFixed(2)} of ${limit.toFixed(2)} m`;
}
