//! A synthetic clutter of blocks and balls on a table, ray-cast: what tests and benchmarks look at.

use graspd_planner::frame::{DepthImage, Frame, Intrinsics};
use nalgebra::{Isometry3, Matrix3, Point3, Rotation3, UnitQuaternion, Vector3};

/// An object: where it stands on the table, its radius (half its edge), and whether it is a ball.
pub(crate) type Object = ([f64; 2], f64, bool);

/// Distance along a ray to a ball or to an upright box on the table z = 0.
fn hit(origin: &Point3<f64>, ray: &Vector3<f64>, object: &Object) -> Option<f64> {
    let &([x, y], radius, is_ball) = object;
    let center = Vector3::new(x, y, radius);
    if is_ball {
        let o = origin.coords - center;
        let (a, b, c) = (ray.norm_squared(), o.dot(ray), o.norm_squared() - radius * radius);
        let root = b * b - a * c;
        return (root >= 0.0).then(|| (-b - root.sqrt()) / a);
    }
    let (mut near, mut far) = (0.0f64, f64::INFINITY);
    for k in 0..3 {
        let (s, t) = ((center[k] - radius - origin[k]) / ray[k], (center[k] + radius - origin[k]) / ray[k]);
        near = near.max(s.min(t));
        far = far.min(s.max(t));
    }
    (near <= far).then_some(near)
}

/// Ten objects of 4 to 6.4 cm.
pub(crate) fn ten_objects() -> Vec<Object> {
    (0..10)
        .map(|k| {
            let at = [0.085 * f64::from(k % 4) - 0.13, 0.1 * f64::from(k / 4) - 0.1];
            (at, 0.02 + 0.003 * f64::from(k % 5), k % 2 == 0)
        })
        .collect()
}

/// 640 × 480 pixels of objects on the table z = 0, from 0.75 m, tilted by 37 degrees.
pub(crate) fn look_at(objects: &[Object]) -> Frame {
    let eye = Point3::new(0.0, -0.45, 0.6);
    let z = -eye.coords.normalize();
    let x = z.cross(&Vector3::z()).normalize();
    let axes = Matrix3::from_columns(&[x, z.cross(&x), z]);
    let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(axes));
    let world_from_camera = Isometry3::from_parts(eye.coords.into(), rotation);
    let lens = Intrinsics { fx_px: 610.0, fy_px: 610.0, cx_px: 319.5, cy_px: 239.5, distortion: [0.0; 8] };
    look_from(objects, &world_from_camera, lens, [640, 480])
}

/// A picture of objects on the table z = 0 from anywhere.
pub(crate) fn look_from(
    objects: &[Object],
    world_from_camera: &Isometry3<f64>,
    intrinsics: Intrinsics,
    [width, height]: [usize; 2],
) -> Frame {
    let eye = Point3::from(world_from_camera.translation.vector);
    let depth_m = (0..width * height)
        .map(|i| {
            let u = ((i % width) as f64 - intrinsics.cx_px) / intrinsics.fx_px;
            let v = ((i / width) as f64 - intrinsics.cy_px) / intrinsics.fy_px;
            let ray = world_from_camera * Vector3::new(u, v, 1.0);
            let table = if ray.z < 0.0 { -eye.z / ray.z } else { f64::INFINITY };
            let depth = objects.iter().filter_map(|o| hit(&eye, &ray, o)).fold(table, f64::min);
            if depth < 3.0 { depth as f32 } else { 0.0 }
        })
        .collect();
    let image = DepthImage { width, height, depth_m };
    Frame { image, intrinsics, world_from_camera: Some(*world_from_camera), labels: None }
}
