// The picture: what the cameras saw, the contact field, the hand at a moment of its grasp; and where one looks from.
import { add, cross, dot, lookAt, mul, perspective, place, rigid, scaled, sub, unit, xyz, fromPose, turn } from "./matrix.js";
import { CENTER, CENTROID, CONTACT, PAD, PALM, ramp } from "./colors.js";
import { Graphics } from "./gl.js";
import { surface } from "./surface.js";
import { bodyPoses, padNormals, posesAt } from "./hand.js";

const ANGLE = 0.75;
export const LAYERS = [["surface", "surface"], ["points", "points"], ["field", "contact field"], ["directions", "field directions"],
  ["hand", "hand"], ["pads", "pads"], ["contacts", "contacts"], ["others", "other grasps"], ["volume", "volume"]];

const colored = (count, color) => new Float32Array(Array(count).fill(color).flat());

export class View {
  constructor(canvas) {
    this.canvas = canvas;
    this.layers = { surface: true, points: true, field: true, directions: false, hand: true, pads: true, contacts: true, others: true, volume: true };
    this.camera = { azimuth: 0.35, elevation: 0.5, distance: 0.82, target: [0, 0, 0] };
    this.up = [0, 0, 1];
    this.middle = [0, 0, 0];
    this.scene = null;
    this.shown = null;
    this.graphics = new Graphics(canvas);
    this.listen();
    new ResizeObserver(() => this.redraw()).observe(canvas);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.redraw());
  }

  // A scene as PlannerService.ReadScene answers, and where its first camera stood, if that is known.
  setScene(read, cameraAt) {
    const g = this.graphics;
    if (this.scene) Object.values(this.scene).flat().forEach(object => g.free(object));
    this.scene = null;
    if (!read) { this.redraw(); return; }
    const { workspace, contact_field: field, points } = read;
    const pose = fromPose(workspace.pose.pose), size = workspace.size_m, table = workspace.table_height_m;
    this.up = turn(pose, [0, 0, 1]);
    this.middle = place(pose, [size / 2, size / 2, table === null ? 0 : table]);
    const surfaces = points.map(frame => surface(frame, this.middle, this.up));
    const certainty = field.certainties, largest = certainty.reduce((a, b) => Math.max(a, b), 1e-9), colors = [], lines = [], lineColors = [];
    for (let i = 0; i < certainty.length; i++) {
      const color = ramp(certainty[i] / largest), p = [...field.contacts_m.slice(3 * i, 3 * i + 3)], d = [...field.inward.slice(3 * i, 3 * i + 3)];
      colors.push(...color);
      lines.push(...p, ...sub(p, scaled(d, 0.012)));
      lineColors.push(...color, ...color);
    }
    const box = [], corner = i => place(pose, [i & 1, i >> 1 & 1, i >> 2 & 1].map(x => x * size));
    for (let a = 0; a < 8; a++) for (const bit of [1, 2, 4]) if (!(a & bit)) box.push(...corner(a), ...corner(a | bit));
    const edges = box.length / 3;
    if (table !== null) {
      const ring = [[0, 0], [size, 0], [size, size], [0, size]].map(([x, y]) => place(pose, [x, y, table + 0.002]));
      ring.forEach((p, i) => box.push(...p, ...ring[(i + 1) % 4]));
    }
    const boxColors = new Float32Array([...colored(edges, [.22, .22, .22]), ...colored(box.length / 3 - edges, [.05, .35, .75])]);
    this.scene = {
      surfaces: surfaces.map(s => g.object(s.positions, { normals: s.normals, colors: s.colors, indices: s.indices })),
      points: surfaces.map(s => g.object(s.positions, { normals: s.normals, colors: s.colors })),
      contacts: g.object(new Float32Array(field.contacts_m), { colors: new Float32Array(colors) }),
      directions: g.object(new Float32Array(lines), { colors: new Float32Array(lineColors) }),
      centroids: g.object(new Float32Array(field.centroids_m), { colors: colored(field.centroids_m.length / 3, CENTROID) }),
      box: g.object(new Float32Array(box), { colors: boxColors }),
    };
    this.pointCount = surfaces.reduce((sum, s) => sum + s.count, 0);
    // From the camera's side, so that what it saw is what one sees.
    this.camera.target = add(this.middle, scaled(this.up, 0.06));
    const [a, b] = this.ground(), out = sub(cameraAt || add(this.middle, add(scaled(this.up, 1), scaled(b, -1))), this.middle);
    this.camera.azimuth = Math.atan2(dot(out, b), dot(out, a)) + 0.35;
    this.camera.elevation = Math.min(Math.max(Math.asin(dot(unit(out), this.up)), 0.3), 0.44);
    this.camera.distance = size * 2.05;
    this.redraw();
  }

  // A hand's model in a colour, at a moment of a grasp; without a grasp the hand alone, over the table. `others` are
  // further grasps, which are drawn as lines.
  setGrasp(shown) {
    const g = this.graphics;
    if (this.shown) this.shown.objects.forEach(object => g.free(object));
    this.shown = shown && { ...shown, objects: [] };
    if (this.shown && shown.grasp) {
      const { contacts, centroid } = shown.grasp, at = contacts.flatMap(c => xyz(c.point));
      const arrows = contacts.flatMap(c => [...xyz(c.point), ...add(xyz(c.point), scaled(xyz(c.normal), 0.03))]);
      const lines = (shown.others || []).flatMap(o => [...xyz(o.pregrasp_pose.pose.position), ...xyz(o.wrist_pose.pose.position), ...xyz(o.wrist_pose.pose.position), ...xyz(o.centroid)]);
      this.shown.objects = [
        g.object(new Float32Array(at), { colors: colored(contacts.length, CONTACT) }),
        g.object(new Float32Array(arrows), { colors: colored(2 * contacts.length, CONTACT) }),
        g.object(new Float32Array(xyz(centroid)), { colors: colored(1, CENTER) }),
        g.object(new Float32Array(lines), { colors: colored(lines.length / 3, shown.color) }),
      ];
    }
    this.redraw();
  }

  setMoment(moment) {
    if (this.shown) this.shown.moment = moment;
    this.redraw();
  }

  // Two directions along the table.
  ground() {
    const a = unit(cross(Math.abs(this.up[0]) < 0.9 ? [1, 0, 0] : [0, 1, 0], this.up));
    return [a, cross(this.up, a)];
  }

  poses() {
    const { model, grasp, moment, rest } = this.shown;
    if (grasp) return posesAt(model, grasp, moment);
    // The hand alone: its approach axis down, its tool point over the middle of the table.
    const down = scaled(this.up, -1), axis = cross(rest.approach, down), cos = dot(rest.approach, down);
    let q = [...axis, 1 + cos];
    if (cos < -0.999) q = [...unit(cross(rest.approach, Math.abs(rest.approach[0]) < 0.9 ? [1, 0, 0] : [0, 1, 0])), 0];
    const n = Math.hypot(...q), turned = rigid(q.map(x => x / n), [0, 0, 0]);
    const tool = turn(turned, rest.tool), at = sub(add(this.middle, scaled(this.up, 0.22)), tool);
    return bodyPoses(model, rigid(q.map(x => x / n), at), joint => rest.joints.get(joint) || 0);
  }

  redraw() {
    if (this.queued) return;
    this.queued = true;
    requestAnimationFrame(() => { this.queued = false; this.frame(); });
  }

  frame() {
    const { canvas, graphics: g, camera, layers: on, scene, shown } = this, gl = g.gl;
    const ratio = Math.min(devicePixelRatio || 1, 2), width = Math.round(canvas.clientWidth * ratio), height = Math.round(canvas.clientHeight * ratio);
    if (!width || !height) return;
    if (canvas.width !== width || canvas.height !== height) { canvas.width = width; canvas.height = height; }
    const sky = getComputedStyle(canvas).backgroundColor.match(/[\d.]+/g).map(x => x / 255);
    gl.viewport(0, 0, width, height);
    gl.clearColor(sky[0], sky[1], sky[2], 1);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.enable(gl.DEPTH_TEST);
    gl.enable(gl.BLEND);
    gl.blendFuncSeparate(gl.SRC_ALPHA, gl.ONE_MINUS_SRC_ALPHA, gl.ONE, gl.ONE);
    const [a, b] = this.ground();
    const out = add(scaled(add(scaled(a, Math.cos(camera.azimuth)), scaled(b, Math.sin(camera.azimuth))), Math.cos(camera.elevation)), scaled(this.up, Math.sin(camera.elevation)));
    const eye = add(camera.target, scaled(out, camera.distance)), look = lookAt(eye, camera.target, this.up);
    this.right = [look[0], look[4], look[8]];
    this.above = [look[1], look[5], look[9]];
    // A narrow picture looks at the same things from further away.
    const aspect = width / height, angle = aspect < 1 ? 2 * Math.atan(Math.tan(ANGLE / 2) / aspect) : ANGLE;
    const view = { eye, up: this.up, clip: mul(perspective(angle, aspect, 0.02, 6), look), scale: height / (2 * Math.tan(angle / 2)),
      light: unit(add(add(this.up, scaled(this.right, -0.5)), scaled(out, 0.25))) };
    // In the dark what the camera saw does not outshine the rest.
    const tint = sky[0] + sky[1] + sky[2] < 1.5 ? [0.45, 0.46, 0.5] : [1, 1, 1];
    if (scene) {
      g.useLit(view, { tint });
      if (on.surface) scene.surfaces.forEach(s => g.draw(s, gl.TRIANGLES));
      g.useLit(view, { tint, size: on.surface ? 0.0012 : 0.0028 });
      if (on.points) scene.points.forEach(p => g.draw(p, gl.POINTS));
    }
    if (shown && shown.model && (on.hand || on.pads)) this.hand(view);
    if (scene) {
      if (on.field) {
        g.useMark(view, { size: 0.0042 });
        g.draw(scene.contacts, gl.POINTS);
        gl.disable(gl.DEPTH_TEST);
        g.useMark(view, { size: 0.011, edge: 0.25 });
        g.draw(scene.centroids, gl.POINTS);
        gl.enable(gl.DEPTH_TEST);
      }
      g.useMark(view, { round: false });
      if (on.directions) g.draw(scene.directions, gl.LINES);
    }
    if (shown && shown.objects.length) {
      const [marks, arrows, center, others] = shown.objects;
      g.useMark(view, { round: false, alpha: 0.55 });
      if (on.others) g.draw(others, gl.LINES);
      if (on.contacts) {
        gl.disable(gl.DEPTH_TEST);
        g.useMark(view, { round: false });
        g.draw(arrows, gl.LINES);
        g.useMark(view, { size: 0.009, edge: 0.28 });
        g.draw(marks, gl.POINTS);
        g.useMark(view, { size: 0.007, edge: 0.3 });
        g.draw(center, gl.POINTS);
        gl.enable(gl.DEPTH_TEST);
      }
    }
    if (scene && on.volume) {
      g.useMark(view, { round: false, alpha: 0.7 });
      g.draw(scene.box, gl.LINES);
    }
    canvas.dataset.frames = Number(canvas.dataset.frames || 0) + 1;
  }

  hand(view) {
    const { graphics: g, layers: on, shown } = this, gl = g.gl, poses = this.poses();
    if (on.hand) shown.model.objects.forEach((object, i) => {
      g.useLit(view, { model: poses[i], tint: i === 0 ? PALM : shown.color, flat: true });
      g.draw(object, gl.TRIANGLES);
    });
    if (!on.pads) return;
    shown.model.padObjects.forEach((object, i) => {
      g.useLit(view, { model: poses[shown.model.patches[i].body], tint: PAD });
      g.draw(object, gl.TRIANGLES);
    });
    const arrows = g.object(padNormals(shown.model, poses), { colors: colored(2 * shown.model.patches.length, PAD) });
    g.useMark(view, { round: false });
    g.draw(arrows, gl.LINES);
    g.free(arrows);
  }

  // === Looking around
  turnBy(dx, dy) {
    this.camera.azimuth -= dx;
    this.camera.elevation = Math.min(Math.max(this.camera.elevation + dy, -0.2), 1.55);
    this.redraw();
  }

  zoomBy(factor) {
    this.camera.distance = Math.min(Math.max(this.camera.distance * factor, 0.12), 4);
    this.redraw();
  }

  panBy(dx, dy) {
    const s = this.camera.distance * 0.78 / this.canvas.clientHeight;
    this.camera.target = sub(this.camera.target, add(scaled(this.right, dx * s), scaled(this.above, -dy * s)));
    this.redraw();
  }

  listen() {
    const { canvas } = this, pointers = new Map();
    let spread = 0;
    canvas.addEventListener("pointerdown", e => { canvas.setPointerCapture(e.pointerId); pointers.set(e.pointerId, [e.clientX, e.clientY]); spread = 0; });
    for (const end of ["pointerup", "pointercancel"]) canvas.addEventListener(end, e => { pointers.delete(e.pointerId); spread = 0; });
    canvas.addEventListener("contextmenu", e => e.preventDefault());
    canvas.addEventListener("pointermove", e => {
      const old = pointers.get(e.pointerId);
      if (!old) return;
      const dx = e.clientX - old[0], dy = e.clientY - old[1];
      pointers.set(e.pointerId, [e.clientX, e.clientY]);
      if (pointers.size === 2) {
        const [p, q] = [...pointers.values()], now = Math.hypot(p[0] - q[0], p[1] - q[1]);
        if (spread) this.zoomBy(spread / now);
        spread = now;
        this.panBy(dx / 2, dy / 2);
      } else if (e.shiftKey || e.buttons & 6) this.panBy(dx, dy);
      else this.turnBy(dx * 0.006, dy * 0.006);
    });
    canvas.addEventListener("wheel", e => { e.preventDefault(); this.zoomBy(Math.exp(e.deltaY * 0.001)); }, { passive: false });
    canvas.addEventListener("keydown", e => {
      const act = { ArrowLeft: () => this.turnBy(0.12, 0), ArrowRight: () => this.turnBy(-0.12, 0), ArrowUp: () => this.turnBy(0, 0.08),
        ArrowDown: () => this.turnBy(0, -0.08), "+": () => this.zoomBy(0.88), "=": () => this.zoomBy(0.88), "-": () => this.zoomBy(1.14) }[e.key];
      if (!act || e.ctrlKey || e.altKey || e.metaKey) return;
      e.preventDefault();
      e.stopPropagation();
      act();
    });
  }
}
