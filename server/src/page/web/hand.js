// A hand's shape and how its parts move: meshes by body, and the bodies' poses at a moment of a grasp.
import { add, between, fromPose, IDENTITY, moved, mul, place, scaled, turn, turned, xyz } from "./matrix.js";

// Hands of more triangles than this are drawn by their collision shapes.
const MOST_TRIANGLES = 60000;
const ROUND = 20;
const PRISMATIC = 2;

function box({ half_extents_m }) {
  const h = xyz(half_extents_m), vertices = [], triangles = [];
  for (let i = 0; i < 8; i++) vertices.push((i & 1 ? 1 : -1) * h[0], (i & 2 ? 1 : -1) * h[1], (i & 4 ? 1 : -1) * h[2]);
  for (const [a, b, c, d] of [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]]) triangles.push(a, b, c, a, c, d);
  return { vertices, triangles };
}

function cylinder({ radius_m: r, half_length_m: h }) {
  const vertices = [0, 0, -h, 0, 0, h], triangles = [];
  for (let i = 0; i < ROUND; i++) {
    const a = 2 * Math.PI * i / ROUND, low = 2 + 2 * i, next = 2 + 2 * ((i + 1) % ROUND);
    vertices.push(r * Math.cos(a), r * Math.sin(a), -h, r * Math.cos(a), r * Math.sin(a), h);
    triangles.push(0, next, low, 1, low + 1, next + 1, low, next, next + 1, low, next + 1, low + 1);
  }
  return { vertices, triangles };
}

function sphere({ radius_m: r }) {
  const vertices = [], triangles = [], rings = ROUND / 2, at = (i, j) => i * ROUND + j % ROUND;
  for (let i = 0; i <= rings; i++) for (let j = 0; j < ROUND; j++) {
    const a = Math.PI * i / rings, b = 2 * Math.PI * j / ROUND;
    vertices.push(r * Math.sin(a) * Math.cos(b), r * Math.sin(a) * Math.sin(b), r * Math.cos(a));
  }
  for (let i = 0; i < rings; i++) for (let j = 0; j < ROUND; j++)
    triangles.push(at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j), at(i + 1, j + 1), at(i, j + 1));
  return { vertices, triangles };
}

const mesh = ({ vertices_m, triangles }) => ({ vertices: vertices_m, triangles });
const form = shape => shape.box ? box(shape.box) : shape.cylinder ? cylinder(shape.cylinder) : shape.sphere ? sphere(shape.sphere)
  : shape.mesh ? mesh(shape.mesh) : { vertices: [], triangles: [] };

// One mesh for each body: the shapes that are fixed to it.
function bodyMeshes(bodyCount, shapes) {
  const meshes = Array.from({ length: bodyCount }, () => ({ vertices: [], triangles: [] }));
  for (const shape of shapes) {
    const target = meshes[shape.body];
    if (!target) continue;
    const { vertices, triangles } = form(shape), pose = fromPose(shape.body_from_shape), base = target.vertices.length / 3;
    for (let i = 0; i < vertices.length; i += 3) {
      const p = place(pose, [vertices[i], vertices[i + 1], vertices[i + 2]]);
      target.vertices.push(p[0], p[1], p[2]);
    }
    for (const t of triangles) target.triangles.push(base + t);
  }
  return meshes;
}

// A hand as HandService.GetHandGeometry describes it, on its way to the graphics card.
export function handModel(geometry, graphics) {
  const { bodies, visual_shapes, collision_shapes, pads } = geometry;
  let meshes = bodyMeshes(bodies.length, visual_shapes);
  if (meshes.reduce((sum, m) => sum + m.triangles.length / 3, 0) > MOST_TRIANGLES) meshes = bodyMeshes(bodies.length, collision_shapes);
  const patches = pads.map(pad => {
    // A little over the surface, or it would flicker.
    const c = add(xyz(pad.center_m), scaled(xyz(pad.normal), 0.0006)), u = xyz(pad.half_u_m), v = xyz(pad.half_v_m);
    const corner = (s, t) => add(c, add(scaled(u, s), scaled(v, t)));
    return { name: pad.name, body: pad.body, corners: [corner(-1, -1), corner(1, -1), corner(1, 1), corner(-1, 1)], normal: xyz(pad.normal) };
  });
  return {
    revision: geometry.revision,
    bodies,
    patches,
    objects: graphics && meshes.map(m => m.triangles.length
      ? graphics.object(new Float32Array(m.vertices), { indices: new Uint32Array(m.triangles) }) : null),
    padObjects: graphics && patches.map(({ corners: [a, b, c, d], normal }) =>
      graphics.object(new Float32Array([a, b, c, a, c, d].flat()), { normals: new Float32Array(Array(6).fill(normal).flat()) })),
  };
}

// Poses of all bodies in the world, where the hand's root is at `root` and its joints are as `position` says by name.
export function bodyPoses(model, root, position) {
  const poses = [];
  for (const body of model.bodies) {
    if (body.parent === null) { poses.push(root); continue; }
    const value = position(body.joint), axis = xyz(body.axis);
    const motion = body.joint_type === PRISMATIC ? moved(scaled(axis, value)) : turned(axis, value);
    poses.push(mul(mul(poses[body.parent] || IDENTITY, fromPose(body.parent_from_joint)), motion));
  }
  return poses;
}

// The moment of a grasp as a number: 0 open before the approach, 1 touching, 2 pressing. In the first half of the way to 1
// the open hand approaches, in the second it closes.
export function posesAt(model, grasp, moment) {
  const approach = Math.min(moment / 0.5, 1), close = Math.min(Math.max(moment - 0.5, 0) / 0.5, 1), squeeze = Math.min(Math.max(moment - 1, 0), 1);
  const root = between(grasp.pregrasp_pose.pose, grasp.wrist_pose.pose, approach);
  const { names, open, contact, squeezed } = grasp.joints;
  const values = new Map(names.map((name, i) => [name, open[i] + (contact[i] - open[i]) * close + (squeezed[i] - contact[i]) * squeeze]));
  return bodyPoses(model, root, joint => values.get(joint) || 0);
}

// Arrows of the pads' normals at these poses, for lines.
export const padNormals = (model, poses) => new Float32Array(model.patches.flatMap(({ corners, normal, body }) => {
  const middle = scaled(add(corners[0], corners[2]), 0.5), from = place(poses[body], middle);
  return [...from, ...add(from, scaled(turn(poses[body], normal), 0.012))];
}));
