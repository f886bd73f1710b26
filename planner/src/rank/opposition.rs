//! Whether fingers hold an object between them: pads of two fingers that face each other.

use nalgebra::Vector3;

/// Pads of two fingers face each other when their mean normals differ by more than this cosine (about 100°).
const FACING: f64 = -0.2;

/// What one finger touches with: the sums over its touching contact candidates.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Side {
    points: Vector3<f64>,
    normals: Vector3<f64>,
    count: usize,
}

/// The sides of a grasp, one for each finger of `fingers` that touches.
///
/// `touches` are the touching candidates: finger, point, and the pad's outward normal.
pub(crate) fn sides(
    fingers: usize,
    touches: impl Iterator<Item = (usize, Vector3<f64>, Vector3<f64>)>,
) -> Vec<Side> {
    let none = Side { points: Vector3::zeros(), normals: Vector3::zeros(), count: 0 };
    let mut all = vec![none; fingers];
    for (finger, point, normal) in touches {
        if let Some(side) = all.get_mut(finger) {
            side.points += point;
            side.normals += normal;
            side.count += 1;
        }
    }
    all.retain(|s| s.count > 0);
    all
}

/// True when two of the sides face each other: their pads press towards each other.
///
/// Contacts may have force closure by their surface normals and yet not hold, where all pads that touch press the
/// same way: fingers side by side on top of an object push it away. A finger can press only the way it closes.
pub(crate) fn face_each_other(sides: &[Side]) -> bool {
    sides.iter().enumerate().any(|(i, a)| sides[..i].iter().any(|b| face(a, b)))
}

fn face(a: &Side, b: &Side) -> bool {
    let from_a_to_b = b.points / b.count as f64 - a.points / a.count as f64;
    a.normals.dot(&b.normals) < FACING * a.normals.norm() * b.normals.norm()
        && from_a_to_b.dot(&a.normals) > 0.0
        && from_a_to_b.dot(&b.normals) < 0.0
}

#[cfg(test)]
mod tests {
    use super::*;

    fn touch(finger: usize, x: f64, normal: Vector3<f64>) -> (usize, Vector3<f64>, Vector3<f64>) {
        (finger, Vector3::new(x, 0.0, 0.0), normal)
    }

    #[test]
    fn a_pinch_faces_and_fingers_side_by_side_do_not() {
        let holds = |touches: &[(usize, Vector3<f64>, Vector3<f64>)]| {
            face_each_other(&sides(3, touches.iter().copied()))
        };
        let (left, right) = (touch(0, -0.02, Vector3::x()), touch(1, 0.02, -Vector3::x()));
        assert!(holds(&[left, right]));
        assert!(holds(&[left, right, touch(2, 0.0, Vector3::z())]), "a third finger does no harm");
        assert!(!holds(&[touch(0, -0.02, Vector3::z()), touch(1, 0.02, Vector3::z())]), "both press down");
        assert!(!holds(&[touch(0, 0.02, Vector3::x()), touch(1, -0.02, -Vector3::x())]), "they press apart");
        assert!(!holds(&[left, touch(0, 0.02, -Vector3::x())]), "one finger does not hold by itself");
        assert!(!holds(&[]));
    }

    #[test]
    fn three_fingers_around_a_ball_face_each_other() {
        let around = (0..3).map(|k| {
            let angle = f64::from(k) * std::f64::consts::TAU / 3.0;
            let out = Vector3::new(angle.cos(), angle.sin(), 0.0);
            (k as usize, out * 0.03, -out)
        });
        assert!(face_each_other(&sides(3, around)));
    }
}
