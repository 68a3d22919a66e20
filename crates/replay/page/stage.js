// The picture: surfaces in their frames, light, camera.

import * as THREE from "three";
import { OrbitControls } from "three/addons/controls/OrbitControls.js";

import { Arrows } from "./arrows.js";
import { keyOf, lightOf, materialOf, paint, skyOf } from "./look.js";

const SHADOW_HALF = 3.2;
const LIGHT_AWAY = 9;
// Things that may hide the robot from a camera that follows.
const OBSTACLES = ["bench", "crate", "fixture", "ladder", "room"];
// Bearings that are tried, from the camera's own, and the most it turns in a frame, rad.
const TURNS = [0, 1, -1, 2, -2, 3, -3, 4, -4, 5, -5, 6].map((step) => (step * Math.PI) / 9);
const TURN_A_FRAME = 0.03;

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
    this.renderer.shadowMap.type = THREE.BasicShadowMap;
    this.scene = new THREE.Scene();
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
    // The graphics card was taken away, such as from a tab in the background, and is back.
    canvas.addEventListener("webglcontextrestored", changed);
    this.pelvis = new THREE.Vector3();
    this.resetView();
  }

  addLight(light) {
    this.look = lightOf(light);
    this.key = keyOf(this.look, SHADOW_HALF, LIGHT_AWAY);
    this.towardsKey = new THREE.Vector3(...light.key_direction).multiplyScalar(-LIGHT_AWAY);
    this.scene.add(this.key, this.key.target, skyOf(this.look));
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
    const materials = stage.materials.map((material) => materialOf(material, this.look));
    this.lights = stage.materials.flatMap(({ lit }, index) => {
      return lit === null ? [] : [{ material: materials[index], off: stage.materials[index], on: stage.materials[lit] }];
    });
    this.obstacles = [];
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
      if (OBSTACLES.includes(mesh.part)) this.obstacles.push(object);
      (mesh.frame === null ? this.scene : this.frames[mesh.frame]).add(object);
    }
  }

  resize() {
    // A headset has sizes of its own.
    if (this.renderer.xr.isPresenting) return;
    const { clientWidth: width, clientHeight: height } = this.canvas;
    if (width === 0 || height === 0) return;
    const pixels = this.renderer.getSize(new THREE.Vector2());
    if (pixels.x === width && pixels.y === height) return;
    this.renderer.setSize(width, height, false);
    this.camera.aspect = width / height;
    // A scene that fits in a wide picture fits in a tall one too.
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

  // Keeps the robot in the middle from now on, or lets it go.
  follow(is) {
    this.following = is;
    if (!is) return;
    const moved = new THREE.Vector3(0, 0, 0.3).add(this.frames[0].position).sub(this.controls.target);
    this.controls.target.add(moved);
    this.camera.position.add(moved);
  }

  // Turns about the robot to the nearest bearing from which most of it is seen, at once or bit by bit.
  keepInSight(isPlaying) {
    const target = this.controls.target;
    const away = this.camera.position.clone().sub(target);
    const turned = (angle) => away.clone().applyAxisAngle(this.camera.up, angle);
    let [found, least] = [0, Infinity];
    for (const angle of TURNS) {
      const hidden = this.hiddenFrom(target.clone().add(turned(angle)));
      if (hidden < least) [found, least] = [angle, hidden];
      if (hidden === 0) break;
    }
    if (found === 0) return;
    const angle = isPlaying ? Math.sign(found) * Math.min(Math.abs(found), TURN_A_FRAME) : found;
    this.camera.position.copy(target).add(turned(angle));
    this.camera.lookAt(target);
  }

  // Number of pelvis, head and knee that something hides from a place.
  hiddenFrom(eye) {
    const ray = new THREE.Raycaster();
    const head = new THREE.Vector3(0, 0, 0.42);
    const points = [this.frames[0].position, head.applyQuaternion(this.frames[0].quaternion).add(this.frames[0].position)];
    const knee = this.frames[this.frameOf.left_knee_link];
    if (knee) points.push(knee.position);
    return points.filter((point) => {
      const to = point.clone().sub(eye);
      ray.set(eye, to.clone().normalize());
      ray.far = to.length();
      return ray.intersectObjects(this.obstacles, false).length > 0;
    }).length;
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

  draw(step, { freshSeated }, isPlaying = false) {
    this.resize();
    const around = this.track.around(step);
    this.place(around);
    const pelvis = this.frames[0].position;
    if (this.following) {
      const moved = pelvis.clone().sub(this.pelvis);
      this.controls.target.add(moved);
      this.camera.position.add(moved);
      this.camera.lookAt(this.controls.target);
      if (moved.lengthSq() > 0) this.keepInSight(isPlaying);
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
