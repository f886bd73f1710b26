//! The page of a plan: one HTML file that needs no network, drawn with WebGL 2.
//!
//! Forward kinematics is done here: the page gets one mesh per body of each hand, and every body's pose at
//! the three moments of each grasp. Lengths travel as 16-bit integers about the middle of the table.

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use nalgebra::{Isometry3, Point3, Translation3, Vector3};
use serde_json::{Value, json};

use super::mesh::{self, TriangleMesh};
use super::surface::Surface;
use super::{HandView, Moment, ViewScene, accent, body_poses};
use crate::outcome::GraspOutcome;

const TEMPLATE: &str = include_str!("page.html");

/// Unit of coordinates in the page, metres.
const UNIT_M: f64 = 1e-4;
/// What is further from the middle of the table than this is left out, metres.
const REACH_M: f64 = 0.55;
/// Hands of more triangles than this are drawn by their collision shapes.
const MAX_TRIANGLES: usize = 20_000;

/// Writes the page.
pub(crate) fn render(title: &str, about: &str, scene: &ViewScene, hands: &[HandView<'_>]) -> String {
    let data = json!({
        "title": title,
        "about": about,
        "unit": UNIT_M,
        "voxel": scene.workspace.grid.voxel_m() * 0.9,
        "edge": 0.016,
        "up": array(&scene.up()),
        "view": first_view(scene),
        "surface": scene.frame.as_ref().map(|frame| surface(&Surface::new(frame, &scene.world_from_camera, 2), scene)),
        "voxels": (!scene.voxels.is_empty()).then(|| encode_points(scene.voxels.iter(), &scene.middle())),
        "volume": volume(scene),
        "contacts": contacts(scene),
        "centroids": scene.centroids.iter().map(|(p, w)| {
            let at = p - scene.middle();
            json!([short(at.x), short(at.y), short(at.z), short(*w)])
        }).collect::<Vec<_>>(),
        "hands": hands.iter().enumerate().map(|(i, view)| hand(i, view, &scene.middle())).collect::<Vec<_>>(),
    });
    // Inside a script element only `<` could end it; as \u003c it is the same JSON.
    let data = data
        .to_string()
        .replace('<', "\\u003c")
        .replace('\u{2028}', "\\u2028")
        .replace('\u{2029}', "\\u2029");
    TEMPLATE.replacen("__TITLE__", &escape(title), 1).replacen("__DATA__", &data, 1)
}

/// Text as HTML.
fn escape(text: &str) -> String {
    let mut out = String::new();
    for c in text.chars() {
        match c {
            '&' => out.push_str("&amp;"),
            '<' => out.push_str("&lt;"),
            '>' => out.push_str("&gt;"),
            '"' => out.push_str("&quot;"),
            '\'' => out.push_str("&#39;"),
            _ => out.push(c),
        }
    }
    out
}

/// Azimuth and elevation that look from the camera's side, in the axes that the page makes of `up`.
fn first_view(scene: &ViewScene) -> Value {
    let up = scene.up();
    let helper = if up.x.abs() < 0.9 { Vector3::x() } else { Vector3::y() };
    let a = helper.cross(&up).normalize();
    let b = up.cross(&a);
    let out = scene.world_from_camera.translation.vector - scene.middle().coords;
    let out = if out.norm() > 1e-6 { out.normalize() } else { up };
    let azimuth = out.dot(&b).atan2(out.dot(&a));
    json!({ "azimuth": short(azimuth + 0.35), "elevation": short(out.dot(&up).asin().clamp(0.3, 0.62)) })
}

fn surface(surface: &Surface, scene: &ViewScene) -> Value {
    let middle = scene.middle();
    let kept: Vec<usize> = (0..surface.points.len())
        .filter(|&i| surface.points[i].is_some_and(|p| (p - middle).norm() < REACH_M))
        .collect();
    let pixels: Vec<u8> = kept.iter().flat_map(|&i| (i as u32).to_le_bytes()).collect();
    let normals: Vec<u8> = kept.iter().flat_map(|&i| direction(&surface.normals[i])).collect();
    json!({
        "width": surface.width,
        "height": surface.height,
        "pixels": STANDARD.encode(pixels),
        "points": encode_points(kept.iter().filter_map(|&i| surface.points[i].as_ref()), &middle),
        "normals": STANDARD.encode(normals),
    })
}

fn volume(scene: &ViewScene) -> Value {
    let pose = about(&scene.middle()) * scene.workspace.world_from_volume;
    json!({
        "size": scene.workspace.grid.size_m,
        "table": scene.workspace.table_m,
        "matrix": pose.to_homogeneous().iter().map(|&x| short(x)).collect::<Vec<_>>(),
    })
}

fn contacts(scene: &ViewScene) -> Value {
    let inward: Vec<u8> = scene.contacts.iter().flat_map(|c| direction(&c.inward)).collect();
    let certainty: Vec<u8> =
        scene.contacts.iter().map(|c| (c.certainty.clamp(0.0, 1.0) * 255.0).round() as u8).collect();
    json!({
        "points": encode_points(scene.contacts.iter().map(|c| &c.point), &scene.middle()),
        "inward": STANDARD.encode(inward),
        "certainty": STANDARD.encode(certainty),
    })
}

fn hand(index: usize, view: &HandView<'_>, middle: &Point3<f64>) -> Value {
    let mut bodies = mesh::of_hand(view.hand);
    if bodies.iter().map(|b| b.triangles.len()).sum::<usize>() > MAX_TRIANGLES {
        let plain = graspd_hands::Hand { visuals: view.hand.collision.clone(), ..view.hand.clone() };
        bodies = mesh::of_hand(&plain);
    }
    // Vertices of a hand travel in units that let its largest body fit 16 bits.
    let largest = bodies.iter().flat_map(|b| &b.vertices).map(|p| p.coords.amax()).fold(0.1, f64::max);
    let unit = largest / f64::from(i16::MAX - 1);
    let (reason, fix) = view.outcome.no_grasp.clone().unwrap_or_default();
    let grasps = view.outcome.grasps.iter().filter_map(|g| grasp(view, g, middle)).collect::<Vec<_>>();
    json!({
        "id": view.hand.id,
        "name": view.hand.display_name,
        "color": accent(index),
        "unit": unit,
        "meshes": bodies.iter().map(|b| body_mesh(b, unit)).collect::<Vec<_>>(),
        "reason": reason,
        "fix": fix,
        "rejected": view.outcome.rejected.iter().map(|(r, n)| json!([r, n])).collect::<Vec<_>>(),
        "grasps": grasps,
    })
}

fn body_mesh(mesh: &TriangleMesh, unit: f64) -> Value {
    if mesh.triangles.is_empty() {
        return json!({});
    }
    let vertices: Vec<u8> = mesh
        .vertices
        .iter()
        .flat_map(|p| [p.x, p.y, p.z])
        .flat_map(|x| ((x / unit).round() as i16).to_le_bytes())
        .collect();
    let triangles: Vec<u8> = mesh.triangles.iter().flatten().flat_map(|i| i.to_le_bytes()).collect();
    json!({ "vertices": STANDARD.encode(vertices), "triangles": STANDARD.encode(triangles) })
}

fn grasp(view: &HandView<'_>, grasp: &GraspOutcome, middle: &Point3<f64>) -> Option<Value> {
    let mut poses = Vec::new();
    for moment in Moment::ALL {
        let bodies = body_poses(view.hand, grasp, moment);
        if bodies.len() != view.hand.tree.bodies.len() {
            return None;
        }
        for pose in bodies {
            let pose = about(middle) * pose;
            let (t, q) = (pose.translation.vector, pose.rotation.coords);
            poses.extend(
                [t.x, t.y, t.z, q.x, q.y, q.z, q.w].into_iter().flat_map(|x| (x as f32).to_le_bytes()),
            );
        }
    }
    let at = |p: &Point3<f64>| array(&(p - middle));
    let actuators = (0..grasp.actuators.names.len()).filter_map(|i| {
        let v = &grasp.actuators.values;
        Some(json!([
            grasp.actuators.names[i],
            short(*v.open.get(i)?),
            short(*v.contact.get(i)?),
            short(*v.squeezed.get(i)?)
        ]))
    });
    let q = grasp.world_from_hand.rotation.coords;
    let orientation = [q.x, q.y, q.z, q.w].map(short);
    let p = grasp.parts;
    let parts = [p.objective, p.force_closure, p.clearance, p.certainty].map(short);
    Some(json!({
        "score": short(grasp.score),
        "parts": parts,
        "position": array(&grasp.world_from_hand.translation.vector),
        "orientation": orientation,
        "width": grasp.jaw_width_m.map(short),
        "clearance": short(grasp.clearance_m),
        "epsilon": short(grasp.epsilon),
        "objective": short(grasp.objective),
        "actuators": actuators.collect::<Vec<_>>(),
        "centroid": at(&grasp.centroid),
        "contacts": grasp.contacts.iter().map(|c| json!({
            "point": at(&c.point),
            "normal": array(&c.normal),
            "finger": c.finger,
            "pad": c.pad,
            "certainty": short(c.certainty),
        })).collect::<Vec<_>>(),
        "poses": STANDARD.encode(poses),
    }))
}

/// Moves the world so that `middle` is the origin.
fn about(middle: &Point3<f64>) -> Isometry3<f64> {
    Translation3::from(-middle.coords).into()
}

/// Points about `middle` as little-endian 16-bit multiples of [`UNIT_M`].
fn encode_points<'a>(points: impl Iterator<Item = &'a Point3<f64>>, middle: &Point3<f64>) -> String {
    let bytes: Vec<u8> = points
        .flat_map(|p| {
            let d = (p - middle) / UNIT_M;
            [d.x, d.y, d.z]
        })
        .flat_map(|x| (x.round() as i16).to_le_bytes())
        .collect();
    STANDARD.encode(bytes)
}

/// A unit vector as three signed bytes.
fn direction(v: &Vector3<f64>) -> [u8; 3] {
    [v.x, v.y, v.z].map(|x| ((x.clamp(-1.0, 1.0) * 127.0).round() as i8) as u8)
}

/// Six decimals; what is no number becomes 0, as JSON has no other.
fn short(x: f64) -> f64 {
    if x.is_finite() { (x * 1e6).round() / 1e6 } else { 0.0 }
}

fn array(v: &Vector3<f64>) -> [f64; 3] {
    [v.x, v.y, v.z].map(short)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::view::fixtures;

    fn page() -> String {
        let (scene, hand, mut outcome) =
            (fixtures::toy_scene(), fixtures::toy_hand(), fixtures::toy_outcome());
        outcome.grasps[0].contacts[0].pad = "</script><b>".into();
        render("A <b> & \"c\"", "about", &scene, &[HandView { hand: &hand, outcome: &outcome }])
    }

    fn data(page: &str) -> Value {
        let start = page.find("id=\"data\">").unwrap() + "id=\"data\">".len();
        let end = start + page[start..].find("</script>").unwrap();
        serde_json::from_str(&page[start..end]).unwrap()
    }

    #[test]
    fn hostile_names_stay_text() {
        let page = page();
        assert!(page.contains("<title>A &lt;b&gt; &amp; &quot;c&quot;</title>"));
        assert!(!page.contains("</script><b>"));
        assert_eq!(data(&page)["hands"][0]["grasps"][0]["contacts"][0]["pad"], "</script><b>");
    }

    #[test]
    fn a_page_is_small_and_needs_no_network() {
        let page = page();
        assert!(page.len() < 3_000_000, "{}", page.len());
        assert!(!page.contains("http://") && !page.contains("https://") && !page.contains("//cdn"));
        if let Some(path) = std::env::var_os("GRASPD_TEST_PAGE") {
            std::fs::write(path, page).unwrap();
        }
    }

    #[test]
    fn poses_hold_every_body_at_every_moment() {
        let data = data(&page());
        let poses = STANDARD.decode(data["hands"][0]["grasps"][0]["poses"].as_str().unwrap()).unwrap();
        assert_eq!(poses.len(), 3 * 3 * 7 * 4);
        let float = |i: usize| f32::from_le_bytes(poses[4 * i..4 * i + 4].try_into().unwrap());
        // The palm at the pre-grasp, 0.23 m over the table whose middle is the world's origin.
        assert!((float(0) - 0.023).abs() < 1e-6 && (float(2) - 0.23).abs() < 1e-6);
        let vertices = data["hands"][0]["meshes"][0]["vertices"].as_str().unwrap();
        assert_eq!(STANDARD.decode(vertices).unwrap().len(), 8 * 3 * 2);
    }
}
