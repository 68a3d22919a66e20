// Contact forces as arrows, from the origin of the frame that they press on.

import * as THREE from "three";

// Metres of arrow for a newton.
const LENGTH = { floor: 0.0016, ladder: 0.0016, old_bulb: 0.01, fresh_bulb: 0.01 };
const COLOUR = { floor: 0x1c9c8f, ladder: 0xe08a16, old_bulb: 0xc2378f, fresh_bulb: 0xc2378f };
const LEAST = 0.02;
const MOST = 1.6;
const HEAD = 0.06;

export class Arrows {
  constructor(forces) {
    this.group = new THREE.Group();
    const shaft = new THREE.CylinderGeometry(0.011, 0.011, 1, 12).translate(0, 0.5, 0);
    const head = new THREE.ConeGeometry(0.032, HEAD, 16).translate(0, HEAD / 2, 0);
    this.list = forces.map(({ by, frame }) => {
      const material = new THREE.MeshBasicMaterial({
        color: COLOUR[by] ?? 0x888888,
        depthTest: false,
        transparent: true,
        opacity: 0.92,
        fog: false,
      });
      const arrow = new THREE.Group();
      const parts = [new THREE.Mesh(shaft, material), new THREE.Mesh(head, material)];
      parts.forEach((part) => {
        part.renderOrder = 10;
      });
      arrow.add(...parts);
      this.group.add(arrow);
      return { arrow, shaft: parts[0], head: parts[1], frame, scale: LENGTH[by] ?? 0.002 };
    });
    this.direction = new THREE.Vector3();
    this.up = new THREE.Vector3(0, 1, 0);
  }

  show(track, around, frames) {
    if (!this.group.visible) return;
    this.list.forEach(({ arrow, shaft, head, frame, scale }, index) => {
      this.direction.fromArray(track.force(around, index));
      const length = Math.min(this.direction.length() * scale, MOST);
      arrow.visible = length > LEAST;
      if (!arrow.visible) return;
      arrow.position.copy(frames[frame].position);
      arrow.quaternion.setFromUnitVectors(this.up, this.direction.normalize());
      shaft.scale.set(1, Math.max(length - HEAD, 0.001), 1);
      head.position.set(0, Math.max(length - HEAD, 0), 0);
    });
  }
}
