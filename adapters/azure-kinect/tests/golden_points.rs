//! Points and colour pixels as the manufacturer's library (libk4a 1.4.2) computes them for the example calibration.
#![allow(clippy::unwrap_used)]

use graspd_adapters_azure_kinect::calibration::{Calibration, EXAMPLE};
use graspd_adapters_azure_kinect::mode::{ColorResolution, DepthMode};

/// Mode, depth pixel; x and y in millimetres at a depth of 1000 mm, pixel of the 720P image; nothing where nothing is seen.
type Golden = (DepthMode, [f64; 2], Option<([f64; 2], [f64; 2])>);

const GOLDEN: [Golden; 13] = [
    (DepthMode::Nfov2x2binned, [50.0, 26.0], Some(([-578.229, -737.611], [272.433, -26.753]))),
    (DepthMode::Nfov2x2binned, [160.0, 144.0], Some(([-24.462, -120.142], [605.103, 342.463]))),
    (DepthMode::Nfov2x2binned, [319.0, 285.0], Some(([762.754, 552.838], [1136.889, 797.01]))),
    (DepthMode::NfovUnbinned, [100.0, 52.0], Some(([-580.076, -739.624], [271.317, -27.962]))),
    (DepthMode::NfovUnbinned, [320.0, 288.0], Some(([-25.46, -121.149], [604.498, 341.854]))),
    (DepthMode::NfovUnbinned, [639.0, 573.0], Some(([766.152, 560.645], [1139.833, 802.872]))),
    (DepthMode::NfovUnbinned, [0.0, 0.0], Some(([-1025.511, -1075.032], [13.223, -219.052]))),
    (DepthMode::Wfov2x2binned, [256.0, 256.0], Some(([-24.352, -32.372], [604.901, 395.904]))),
    (DepthMode::Wfov2x2binned, [80.0, 46.0], None),
    (DepthMode::Wfov2x2binned, [511.0, 509.0], None),
    (DepthMode::WfovUnbinned, [512.0, 512.0], Some(([-25.344, -33.365], [604.295, 395.295]))),
    (DepthMode::WfovUnbinned, [1023.0, 1021.0], None),
    (DepthMode::WfovUnbinned, [0.0, 0.0], None),
];

#[test]
fn points_and_colour_pixels_are_the_manufacturers() {
    let calibration = Calibration::from_json(EXAMPLE.as_bytes()).unwrap();
    let color = calibration.color_lens(ColorResolution::P720).unwrap();
    for (mode, pixel, expected) in GOLDEN {
        let ray = calibration.depth_lens(mode).unproject(pixel);
        let Some(([x, y], [u, v])) = expected else {
            assert_eq!(ray, None, "{mode:?} {pixel:?}");
            continue;
        };
        let found = ray.unwrap();
        let (dx, dy) = (1000.0 * found[0] - x, 1000.0 * found[1] - y);
        assert!(dx.hypot(dy) < 2e-3, "{mode:?} {pixel:?}: {found:?}");
        let point = calibration.color_from_depth([found[0], found[1], 1.0]).unwrap();
        let seen = color.project(point).unwrap();
        assert!((seen[0] - u).hypot(seen[1] - v) < 2e-3, "{mode:?} {pixel:?}: {seen:?}");
    }
}
