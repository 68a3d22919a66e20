// The picture: surfaces in their frames, light, camera.

import * as THREE from "three";
import { OrbitControls } from "three/addons/controls/OrbitControls.js";

import { Arrows } from "./arrows.js";

// Cells of the floor's grid from its middle to its edge, and the side of one, m.
const GRID_CELLS = 24;
const CELL = 0.5;
const SHADOW_HALF = 3;
const LIGHT_AWAY = 9;

export class Stage {
  // `changed` is called when the camera has moved and a picture is needed.
  constructor(canvas, doc, meshes, track, changed) {
    this.canvas = canvas;
    this.track = track;
    this.position = [0, 0, 0];
    this.quaternion = [0, 0, 0, 1];
    this.following = true;
    this.renderer = new THREE.WebGLRenderer({ canvas, antialias: true });
    this.renderer.setPixelRatio(Math.min(devicePixelRatio, 2));
    this.renderer.shadowMap.enabled = true;
    this.renderer.shadowMap.type = THREE.PCFSoftShadowMap;
    this.renderer.toneMapping = THREE.NeutralToneMapping;
    this.scene = new THREE.Scene();
    this.scene.fog = new THREE.Fog(0, 14, 38);
    this.addLight(doc.stage.light);
    this.addSurfaces(doc.stage, meshes);
    this.arrows = new Arrows(track.forces);
    this.scene.add(this.arrows.group);
    this.camera = new THREE.PerspectiveCamera(38, 1, 0.05, 120);
    this.camera.up.set(0, 0, 1);
    this.controls = new OrbitControls(this.camera, canvas);
    this.controls.minDistance = 0.3;
    this.controls.maxDistance = 25;
    this.controls.maxPolarAngle = 0.5 * Math.PI + 0.35;
    this.controls.addEventListener("change", changed);
    this.pelvis = new THREE.Vector3();
    this.resetView();
  }

  addLight(light) {
    this.scene.add(new THREE.HemisphereLight(0xffffff, 0xd2cec6, 2.7 * light.dome));
    const key = new THREE.DirectionalLight(new THREE.Color().setRGB(...light.key_colour), 2.0 * light.key);
    key.castShadow = true;
    key.shadow.mapSize.set(2048, 2048);
    key.shadow.normalBias = 0.02;
    key.shadow.bias = -0.0004;
    const shadow = key.shadow.camera;
    [shadow.left, shadow.right, shadow.bottom, shadow.top] = [-SHADOW_HALF, SHADOW_HALF, -SHADOW_HALF, SHADOW_HALF];
    [shadow.near, shadow.far] = [0.5, 2 * LIGHT_AWAY];
    this.key = key;
    this.towardsKey = new THREE.Vector3(...light.key_direction).multiplyScalar(-LIGHT_AWAY);
    this.scene.add(key, key.target);
    // The lamp itself, where the fresh bulb is in its socket.
    this.lamp = new THREE.PointLight(0xffd894, 0, 6, 2);
    this.scene.add(this.lamp);
  }

  addSurfaces(stage, { positions, normals, indices }) {
    this.frames = stage.frames.map(() => {
      const frame = new THREE.Group();
      this.scene.add(frame);
      return frame;
    });
    this.frameOf = Object.fromEntries(stage.frames.map((frame, index) => [frame.name, index]));
    const materials = stage.materials.map(materialOf);
    this.lights = stage.materials.flatMap(({ lit }, index) => {
      return lit === null ? [] : [{ material: materials[index], off: stage.materials[index], on: stage.materials[lit] }];
    });
    for (const mesh of stage.meshes) {
      const geometry = new THREE.BufferGeometry();
      const from = 3 * mesh.first_vertex;
      const to = from + 3 * mesh.vertices;
      geometry.setAttribute("position", new THREE.BufferAttribute(positions.subarray(from, to), 3));
      geometry.setAttribute("normal", new THREE.BufferAttribute(normals.subarray(from, to), 3));
      const first = mesh.groups[0].first;
      const last = mesh.groups[mesh.groups.length - 1];
      geometry.setIndex(new THREE.BufferAttribute(indices.subarray(first, last.first + last.count), 1));
      mesh.groups.forEach((group, index) => geometry.addGroup(group.first - first, group.count, index));
      const object = new THREE.Mesh(
        geometry,
        mesh.groups.map((group) => materials[group.material]),
      );
      object.castShadow = mesh.shadow;
      object.receiveShadow = true;
      (mesh.frame === null ? this.scene : this.frames[mesh.frame]).add(object);
      if (mesh.part === "floor") this.addGrid(object);
    }
  }

  // Tiles of half a metre, to see by how far something moves.
  addGrid(floor) {
    floor.material.forEach((material) => {
      Object.assign(material, { polygonOffset: true, polygonOffsetFactor: 2, polygonOffsetUnits: 2 });
    });
    const points = [];
    for (let i = -GRID_CELLS; i <= GRID_CELLS; i += 1) {
      // In short pieces: a line that reaches behind the camera is lost in some software renderers.
      for (let j = -GRID_CELLS; j < GRID_CELLS; j += 1) {
        points.push(i * CELL, j * CELL, 0, i * CELL, (j + 1) * CELL, 0, j * CELL, i * CELL, 0, (j + 1) * CELL, i * CELL, 0);
      }
    }
    const geometry = new THREE.BufferGeometry();
    geometry.setAttribute("position", new THREE.Float32BufferAttribute(points, 3));
    const grid = new THREE.LineSegments(
      geometry,
      new THREE.LineBasicMaterial({ color: 0x000000, transparent: true, opacity: 0.14, depthWrite: false }),
    );
    // A little above the floor: lines and surfaces of one height are not sorted alike.
    grid.position.z = 0.002;
    this.scene.add(grid);
  }

  setTheme({ page }) {
    const colour = new THREE.Color(page);
    this.scene.background = colour;
    this.scene.fog.color = colour;
  }

  resize() {
    const { clientWidth: width, clientHeight: height } = this.canvas;
    if (width === 0 || height === 0) return;
    const pixels = this.renderer.getSize(new THREE.Vector2());
    if (pixels.x === width && pixels.y === height) return;
    this.renderer.setSize(width, height, false);
    this.camera.aspect = width / height;
    // What fits in a wide picture fits in a tall one too.
    this.camera.fov = width < height ? 52 : 38;
    this.camera.updateProjectionMatrix();
  }

  // Looks at the robot from ahead and its left, from as far away as robot, ladder and lamp need.
  resetView(step = this.track.first) {
    this.place(this.track.around(step));
    const pelvis = this.frames[0];
    const heading = new THREE.Vector3(1, 0, 0).applyQuaternion(pelvis.quaternion);
    const bearing = Math.atan2(heading.y, heading.x) + 0.9;
    this.pelvis.copy(pelvis.position);
    this.controls.target.copy(pelvis.position).setZ(pelvis.position.z + 0.3);
    const away = new THREE.Vector3(Math.cos(bearing), Math.sin(bearing), 0.4).multiplyScalar(4.1);
    this.camera.position.copy(this.controls.target).add(away);
    this.controls.update();
  }

  // Looks from where another picture does: from its robot to its robot, where the camera follows.
  copyView(other) {
    const moved = new THREE.Vector3();
    if (this.following) moved.copy(this.pelvis).sub(other.pelvis);
    this.controls.target.copy(other.controls.target).add(moved);
    this.camera.position.copy(other.camera.position).add(moved);
    this.camera.lookAt(this.controls.target);
  }

  place(around) {
    this.frames.forEach((frame, index) => {
      this.track.poseAt(around, index, this.position, this.quaternion);
      frame.position.fromArray(this.position);
      frame.quaternion.fromArray(this.quaternion);
    });
  }

  draw(step, { freshSeated }) {
    this.resize();
    const around = this.track.around(step);
    this.place(around);
    const pelvis = this.frames[0].position;
    if (this.following) {
      const moved = pelvis.clone().sub(this.pelvis);
      this.controls.target.add(moved);
      this.camera.position.add(moved);
      this.camera.lookAt(this.controls.target);
    }
    this.pelvis.copy(pelvis);
    this.arrows.show(this.track, around, this.frames);
    this.key.target.position.copy(pelvis);
    this.key.position.copy(pelvis).add(this.towardsKey);
    this.light(freshSeated);
    this.renderer.render(this.scene, this.camera);
  }

  light(on) {
    this.lamp.intensity = on ? 2.5 : 0;
    const bulb = this.frames[this.frameOf.fresh_bulb];
    this.lamp.position.set(0, 0, 0.14).applyQuaternion(bulb.quaternion).add(bulb.position);
    for (const { material, off, on: lit } of this.lights) paint(material, on ? lit : off);
  }
}

function materialOf(look) {
  const material = new THREE.MeshStandardMaterial();
  paint(material, look);
  return material;
}

function paint(material, { colour, roughness, mirror, glow }) {
  material.color.setRGB(...colour);
  material.emissive.setRGB(...colour);
  material.emissiveIntensity = glow;
  material.roughness = Math.max(roughness, 0.25);
  // There is nothing around to be mirrored: a little keeps the highlights, more would only darken.
  material.metalness = Math.min(mirror, 0.2);
}
