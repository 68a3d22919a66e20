// Light and paint of the picture: the same sums as `fiatlux render`, so that a replay looks like its stills.

import * as THREE from "three";

// Light of the nominal dome and key, and the soft shadow's growth: metres of rim for a metre of distance.
const DOME = 0.58;
const KEY = 1.55;
const SOFTNESS = 0.035;

const COMMON = /* glsl */ `
const vec3 SKY = vec3(0.97, 1.0, 1.05);
const vec3 GROUND = vec3(0.56, 0.54, 0.51);
const vec3 HAZE_LOW = vec3(0.60, 0.65, 0.71);
const vec3 HAZE_HIGH = vec3(0.70, 0.78, 0.88);
uniform float dome;
uniform vec3 keyLight;
vec3 haze(vec3 ray) {
  return mix(HAZE_LOW, HAZE_HIGH, clamp(2.0 * ray.z, 0.0, 1.0)) * (dome + 0.25 * keyLight.g);
}
vec3 tone(vec3 light) {
  vec3 x = max(light, 0.0) * 0.92;
  return min(x * (1.9 * x + 0.18) / (x * (1.75 * x + 0.85) + 0.16), 1.0);
}
`;

// The shadow's rim is wider the farther the surface is from what casts it.
const SHADOW = /* glsl */ `
varying vec3 vWorld;
uniform vec2 domeSide;
uniform float mirror, exponent, glow;
uniform int pattern;
uniform float shadowSpan, shadowDepth;
float softShadow(sampler2D map, vec4 place) {
  vec3 at = place.xyz / place.w;
  if (at.z > 1.0 || any(lessThan(at.xy, vec2(0.0))) || any(greaterThan(at.xy, vec2(1.0)))) return 1.0;
  float turn = 6.2831853 * fract(52.9829189 * fract(dot(gl_FragCoord.xy, vec2(0.06711056, 0.00583715))));
  mat2 spin = mat2(cos(turn), sin(turn), -sin(turn), cos(turn));
  float blockers = 0.0;
  float depths = 0.0;
  for (int i = 0; i < 8; i++) {
    float r = sqrt((float(i) + 0.5) / 8.0) * 0.06 / shadowSpan;
    float a = 2.3999632 * float(i);
    float depth = unpackRGBAToDepth(texture2D(map, at.xy + spin * vec2(cos(a), sin(a)) * r));
    if (depth < at.z - 0.0006) { blockers += 1.0; depths += depth; }
  }
  if (blockers < 0.5) return 1.0;
  float away = (at.z - depths / blockers) * shadowDepth;
  float rim = clamp(away * ${SOFTNESS}, 0.004, 0.09) / shadowSpan;
  float lit = 0.0;
  for (int i = 0; i < 16; i++) {
    float r = sqrt((float(i) + 0.5) / 16.0) * rim;
    float a = 2.3999632 * float(i);
    lit += step(at.z - 0.0006, unpackRGBAToDepth(texture2D(map, at.xy + spin * vec2(cos(a), sin(a)) * r)));
  }
  return lit / 16.0;
}
// Tiles of half a metre, smoothed over a pixel.
float tiles(vec2 at, float width) {
  vec2 x = at / 0.5;
  vec2 from = 0.5 * abs(x - floor(x + 0.5));
  float pixel = 0.5 * width;
  vec2 overlap = max(min(vec2(pixel), 0.003 - from) + min(vec2(pixel), 0.003 + from), 0.0);
  float joint = min(max(overlap.x, overlap.y) / width, 1.0);
  float number = 0.5 * (floor(x.x) + floor(x.y));
  float odd = 2.0 * fract(number);
  return (1.0 - odd * 0.05 * max(1.0 - width / 0.5, 0.0)) * (1.0 - 0.35 * joint);
}
`;

const BASE = /* glsl */ `
if (pattern == 1) diffuseColor.rgb *= tiles(vWorld.xy, max(length(fwidth(vWorld.xy)), 0.0001));
if (pattern == 2 && vWorld.z < 0.09) diffuseColor.rgb *= 0.62;
`;

const LIGHT = /* glsl */ `
vec3 n = inverseTransformDirection(normal, viewMatrix);
vec3 ray = normalize(vWorld - cameraPosition);
float around = dome * (1.0 + 0.14 * dot(n.xy, domeSide));
// Near the floor less of the dome is seen.
float open = pattern == 1 ? 1.0 : mix(0.75, 1.0, smoothstep(0.0, 0.35, vWorld.z));
vec3 outgoingLight = reflectedLight.directDiffuse + diffuseColor.rgb * (mix(GROUND, SKY, 0.5 + 0.5 * n.z) * around * open + glow);
if (mirror > 0.0) {
  float back = clamp(-dot(n, ray), 0.0, 1.0);
  vec3 mirrored = reflect(ray, n);
  float share = mirror + (1.0 - mirror) * 0.5 * pow(1.0 - back, 5.0);
  float sky = smoothstep(0.0, 1.0, clamp(0.5 + 0.9 * mirrored.z, 0.0, 1.0));
  outgoingLight += mix(GROUND, SKY, sky) * dome * open * share * 1.6;
  #if NUM_DIR_LIGHTS > 0
  vec3 towards = inverseTransformDirection(directionalLights[0].direction, viewMatrix);
  float shine = pow(max(dot(mirrored, towards), 0.0), exponent);
  outgoingLight += keyLight * shine * 0.12 * exponent * min(share, 0.2) * keyShare;
  #endif
}
if (pattern == 1) {
  float away = smoothstep(6.5, 13.0, length(vWorld.xy));
  outgoingLight = mix(outgoingLight, haze(ray), away);
}
outgoingLight = tone(outgoingLight);
`;

const PATTERNS = { Floor: 1, Wall: 2 };

// Shared by all surfaces and the sky.
export function lightOf({ dome, key, key_colour: colour, dome_yaw: yaw = 0 }) {
  return {
    dome: { value: DOME * dome },
    keyLight: { value: new THREE.Vector3(...colour).multiplyScalar(KEY * key) },
    domeSide: { value: new THREE.Vector2(Math.cos(yaw), Math.sin(yaw)) },
    shadowSpan: { value: 1 },
    shadowDepth: { value: 1 },
  };
}

// A material of the document under that light.
export function materialOf(look, light) {
  const material = new THREE.MeshLambertMaterial();
  const own = { mirror: { value: 0 }, exponent: { value: 1 }, glow: { value: 0 }, pattern: { value: PATTERNS[look.name] ?? 0 } };
  material.userData.own = own;
  material.toneMapped = false;
  material.onBeforeCompile = (shader) => {
    Object.assign(shader.uniforms, light, own);
    shader.vertexShader = `varying vec3 vWorld;\n${shader.vertexShader}`.replace(
      "#include <project_vertex>",
      "#include <project_vertex>\nvWorld = (modelMatrix * vec4(transformed, 1.0)).xyz;",
    );
    const lights = THREE.ShaderChunk.lights_fragment_begin.replace(
      /directLight\.color \*= \( directLight\.visible && receiveShadow \) \? getShadow\( directionalShadowMap[^;]*;/,
      "keyShare = receiveShadow ? softShadow( directionalShadowMap[ i ], vDirectionalShadowCoord[ i ] ) : 1.0; directLight.color *= keyShare;",
    );
    shader.fragmentShader = shader.fragmentShader
      .replace("#include <shadowmap_pars_fragment>", `#include <shadowmap_pars_fragment>\n${COMMON}${SHADOW}`)
      .replace("#include <color_fragment>", `#include <color_fragment>\n${BASE}`)
      .replace("#include <lights_fragment_begin>", `float keyShare = 1.0;\n${lights}`)
      .replace(/vec3 outgoingLight = [^;]*;/, LIGHT);
  };
  material.customProgramCacheKey = () => "fiatlux";
  paint(material, look);
  return material;
}

export function paint(material, { colour, roughness, mirror, glow }) {
  const { own } = material.userData;
  material.color.setRGB(...colour);
  own.mirror.value = mirror;
  // The exponent of the highlight, of which the document has the roughness.
  own.exponent.value = Math.max(2 / roughness ** 4 - 2, 1);
  own.glow.value = glow;
}

// The key light with its shadow; its strength is that of the shader.
export function keyOf(light, half, away) {
  const { value } = light.keyLight;
  const key = new THREE.DirectionalLight(new THREE.Color(value.x, value.y, value.z), Math.PI);
  key.castShadow = true;
  key.shadow.mapSize.set(2048, 2048);
  key.shadow.normalBias = 0.012;
  const camera = key.shadow.camera;
  [camera.left, camera.right, camera.bottom, camera.top] = [-half, half, -half, half];
  [camera.near, camera.far] = [0.5, 2 * away];
  light.shadowSpan.value = 2 * half;
  light.shadowDepth.value = 2 * away - 0.5;
  return key;
}

// The background.
export function skyOf(light) {
  const material = new THREE.ShaderMaterial({
    uniforms: light,
    side: THREE.BackSide,
    depthWrite: false,
    toneMapped: false,
    vertexShader: "varying vec3 vRay; void main() { vRay = position; gl_Position = projectionMatrix * vec4(mat3(modelViewMatrix) * position, 1.0); }",
    fragmentShader: `${COMMON}varying vec3 vRay; void main() { gl_FragColor = vec4(tone(haze(normalize(vRay))), 1.0);\n#include <colorspace_fragment>\n}`,
  });
  const sky = new THREE.Mesh(new THREE.SphereGeometry(60, 24, 16), material);
  sky.frustumCulled = false;
  sky.renderOrder = -1;
  return sky;
}
