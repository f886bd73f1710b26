//! The depth cameras of the paper, and one without faults. Where each value comes from is said at its field.

use super::config::{Amplitude, Axial, Edges, Grazing, Lateral, Range, Sensor, Shiny, Systematic};
use crate::camera::Pinhole;

impl Sensor {
    /// Names of the depth cameras, for [`Sensor::by_name`].
    pub const NAMES: [&'static str; 3] = ["azure-kinect", "pico-flexx", "ideal"];

    /// A depth camera by one of [`Sensor::NAMES`]; `ideal` has no faults and the lens of an Azure Kinect.
    pub fn by_name(name: &str) -> Option<Self> {
        match name {
            "azure-kinect" => Some(Self::azure_kinect()),
            "pico-flexx" => Some(Self::pico_flexx()),
            "ideal" => Some(Self::ideal(Self::azure_kinect().lens)),
            _ => None,
        }
    }

    /// Azure Kinect, NFOV unbinned, 640 x 576.
    pub fn azure_kinect() -> Self {
        let lens = Pinhole {
            width: 640,
            height: 576,
            fx_px: 504.608,
            fy_px: 504.733,
            cx_px: 332.781,
            cy_px: 348.830,
        };
        Self {
            lens,
            range: Range { nearest_m: 0.15, farthest_m: 3.86 },
            amplitude: Amplitude { floor: 0.009, fade: 0.25, ceiling: 34.0 },
            axial: Axial { floor_m: 0.45e-3, linear: 0.64e-3, quadratic: 0.0, cap_m: 0.017 },
            systematic: Systematic {
                device: 0,
                offset_m: 0.0055,
                scale: 0.001,
                wiggle_m: 0.0015,
                wiggle_period_m: 0.7,
            },
            lateral: Lateral { blur: 0.1, jitter_px: 0.2 },
            edges: Edges { step_m: 0.03, reach_px: 1, drop: 0.7 },
            grazing: Grazing { start_deg: 76.0, end_deg: 84.0 },
            shiny: Shiny { anywhere: 0.3, facing: 0.5 },
            illumination: vec![
                [-0.695, -0.09],
                [-0.353, -0.70],
                [0.350, -0.70],
                [0.692, -0.09],
                [0.361, 0.46],
                [-0.364, 0.46],
            ],
            quantum_m: 0.001,
        }
    }

    /// Pico Flexx, 224 x 172, five frames per second with exposures of 2 ms.
    pub fn pico_flexx() -> Self {
        let lens = Pinhole { width: 224, height: 172, fx_px: 212.0, fy_px: 212.0, cx_px: 112.0, cy_px: 86.0 };
        Self {
            lens,
            range: Range { nearest_m: 0.1, farthest_m: 4.0 },
            amplitude: Amplitude { floor: 0.008, fade: 0.25, ceiling: 70.0 },
            axial: Axial { floor_m: 0.001, linear: 0.0, quadratic: 0.0025, cap_m: 0.07 },
            systematic: Systematic {
                device: 0,
                offset_m: 0.005,
                scale: 0.0,
                wiggle_m: 0.005,
                wiggle_period_m: 0.47,
            },
            lateral: Lateral { blur: 0.15, jitter_px: 0.3 },
            edges: Edges { step_m: 0.05, reach_px: 1, drop: 0.7 },
            grazing: Grazing { start_deg: 70.0, end_deg: 80.0 },
            shiny: Shiny { anywhere: 0.3, facing: 0.5 },
            illumination: Vec::new(),
            quantum_m: 0.001,
        }
    }

    /// A camera without faults: every surface within 100 m, exactly.
    pub fn ideal(lens: Pinhole) -> Self {
        Self {
            lens,
            range: Range { nearest_m: 0.0, farthest_m: 100.0 },
            amplitude: Amplitude { floor: 0.0, fade: 0.0, ceiling: 0.0 },
            axial: Axial { floor_m: 0.0, linear: 0.0, quadratic: 0.0, cap_m: 0.0 },
            systematic: Systematic {
                device: 0,
                offset_m: 0.0,
                scale: 0.0,
                wiggle_m: 0.0,
                wiggle_period_m: 1.0,
            },
            lateral: Lateral { blur: 0.0, jitter_px: 0.0 },
            edges: Edges { step_m: 0.03, reach_px: 0, drop: 0.0 },
            grazing: Grazing { start_deg: 90.0, end_deg: 90.0 },
            shiny: Shiny { anywhere: 0.0, facing: 0.0 },
            illumination: Vec::new(),
            quantum_m: 0.0,
        }
    }
}
