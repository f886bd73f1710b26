//! What arms hide of the tray: pixels that an arm's bodies may cover are set to missing, as robots filter themselves out of
//! their own pictures. So the camera can look while arms are at work; what they hide is not planned.

use graspd_assign::Capsule;
use nalgebra::{Point3, Vector2, Vector3};

use crate::config::TrayConfig;
use crate::frame::Frame;

/// A ray without a return goes so far, metres.
const FAR_M: f64 = 3.0;
/// Nearer to the camera than this a body may be anywhere in the image, metres.
const NEAR_M: f64 = 0.05;
/// Heights above the floor at which what a pixel hides is marked, metres.
const HEIGHTS_M: [f64; 5] = [0.0, 0.03, 0.06, 0.09, 0.13];

/// What was taken out of a frame.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Shadow {
    /// Points on rays of missing pixels, up to the height of objects, world x and y.
    pub(super) points: Vec<Vector2<f64>>,
}

/// Takes out of a frame what these bodies may cover.
pub fn hide(frame: &mut Frame, bodies: &[Capsule], tray: &TrayConfig) -> Shadow {
    let Ok(world_from_camera) = frame.world_from_camera() else { return Shadow::default() };
    let (width, height) = (frame.info.width as usize, frame.info.height as usize);
    let info = &frame.info;
    let ray = |u: usize, v: usize| {
        Vector3::new((u as f64 - info.cx) / info.fx, (v as f64 - info.cy) / info.fy, 1.0)
    };
    let mut hidden = vec![false; frame.millimetres.len()];
    for body in bodies {
        let local = |p: &Point3<f64>| world_from_camera.inverse_transform_point(p);
        let body = Capsule { a: local(&body.a), b: local(&body.b), radius_m: body.radius_m };
        let around = |f: f64, c: f64, axis: usize, edge: usize| pixels(&body, axis, f, c, edge);
        let (us, vs) = (around(info.fx, info.cx, 0, width), around(info.fy, info.cy, 1, height));
        for v in vs {
            for u in us.clone() {
                let at = v * width + u;
                if hidden[at] {
                    continue;
                }
                let depth_m = f64::from(frame.millimetres[at]) * info.depth_scale;
                let far_m = if depth_m > 0.0 { depth_m } else { FAR_M };
                let ray = Capsule { a: Point3::origin(), b: Point3::from(ray(u, v) * far_m), radius_m: 0.0 };
                hidden[at] = ray.distance(&body) < 0.0;
            }
        }
    }
    let eye = Point3::from(world_from_camera.translation.vector);
    let mut points = Vec::new();
    for at in (0..hidden.len()).filter(|&at| hidden[at]) {
        let towards = world_from_camera.rotation * ray(at % width, at / width);
        for height_m in HEIGHTS_M {
            let along = (tray.floor_m() + height_m - eye.z) / towards.z;
            if along > 0.0 && along.is_finite() {
                points.push((eye + towards * along).coords.xy());
            }
        }
    }
    for (pixel, _) in frame.millimetres.iter_mut().zip(&hidden).filter(|(_, hidden)| **hidden) {
        *pixel = 0;
    }
    Shadow { points }
}

/// The pixels along one axis of the image in which a body (camera frame) may be.
fn pixels(body: &Capsule, axis: usize, focal: f64, middle: f64, edge: usize) -> std::ops::Range<usize> {
    let nearest = body.a.z.min(body.b.z) - body.radius_m;
    let farthest = body.a.z.max(body.b.z) + body.radius_m;
    if farthest <= 0.0 {
        return 0..0;
    }
    if nearest < NEAR_M {
        return 0..edge;
    }
    let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
    for end in [&body.a, &body.b] {
        for side in [end[axis] - body.radius_m, end[axis] + body.radius_m] {
            for depth in [nearest, farthest] {
                let at = focal * side / depth + middle;
                (low, high) = (low.min(at), high.max(at));
            }
        }
    }
    let whole = |v: f64| v.clamp(0.0, edge as f64) as usize;
    whole(low.floor())..whole(high.ceil() + 1.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sort::objects::tests::frame;

    #[test]
    fn what_is_behind_a_body_is_missing_and_nothing_else_is() {
        let mut seen = frame(&[]);
        let at = |x: f64| Point3::new(x, 0.0, 0.4);
        let body = Capsule { a: at(-0.05), b: at(0.05), radius_m: 0.03 };
        let shadow = hide(&mut seen, &[body], &TrayConfig::default());
        // Twice as large on the floor as half way up: a ray is hidden where it passes within the radius.
        for (x, y, hidden) in
            [(0.0, 0.0, true), (0.14, 0.0, true), (0.18, 0.0, false), (0.0, 0.05, true), (0.0, 0.07, false)]
        {
            let (u, v) = ((160.0 + 400.0 * x / 0.8) as usize, (160.0 - 400.0 * y / 0.8) as usize);
            assert_eq!(seen.millimetres[v * 320 + u] == 0, hidden, "{x} {y}");
            let near = shadow.points.iter().any(|p| (p - Vector2::new(x, y)).norm() < 0.008);
            assert_eq!(near, hidden, "{x} {y}");
        }
        // A body below what is seen hides nothing.
        let mut seen = frame(&[]);
        let below =
            Capsule { a: Point3::new(0.0, 0.0, -0.2), b: Point3::new(0.1, 0.0, -0.2), radius_m: 0.05 };
        assert_eq!(hide(&mut seen, &[below], &TrayConfig::default()), Shadow::default());
        assert_eq!(seen, frame(&[]));
        // One that holds the camera leaves nothing to be seen.
        let over = Capsule { a: Point3::new(0.0, 0.0, 0.8), b: Point3::new(0.1, 0.0, 0.8), radius_m: 0.05 };
        hide(&mut seen, &[over], &TrayConfig::default());
        assert!(seen.millimetres.iter().all(|mm| *mm == 0));
    }
}
