//! The faults have the sizes that their configuration says.

use nalgebra::Isometry3;
use proptest::prelude::*;

use super::*;
use crate::camera::Pinhole;
use crate::render::View;

const LENS: Pinhole =
    Pinhole { width: 160, height: 120, fx_px: 250.0, fy_px: 250.0, cx_px: 79.5, cy_px: 59.5 };

/// A view of what `depth` says for each pixel, everywhere with the same answer to light.
fn view(depth: impl Fn(usize, usize) -> f64, albedo: f64, specular: f64, cos: f64) -> View {
    let pixels = LENS.width * LENS.height;
    View {
        lens: LENS,
        world_from_camera: Isometry3::identity(),
        depth_m: (0..pixels).map(|i| depth(i % LENS.width, i / LENS.width) as f32).collect(),
        instance: vec![1; pixels],
        cos_incidence: vec![cos as f32; pixels],
        albedo: vec![albedo as f32; pixels],
        specular: vec![specular as f32; pixels],
    }
}

/// Without quantization and lateral spread: what is left is one fault.
fn plain(sensor: Sensor) -> Sensor {
    Sensor {
        lens: LENS,
        quantum_m: 0.0,
        lateral: Lateral { blur: 0.0, jitter_px: 0.0 },
        illumination: vec![],
        ..sensor
    }
}

/// Share of missing returns, mean and standard deviation of the error of the others.
fn errors(image: &DepthImage, view: &View) -> (f64, f64, f64) {
    let pairs: Vec<f64> = image
        .depth_m
        .iter()
        .zip(&view.depth_m)
        .filter(|(z, _)| **z > 0.0)
        .map(|(z, exact)| f64::from(z - exact))
        .collect();
    let count = pairs.len() as f64;
    let mean = pairs.iter().sum::<f64>() / count;
    let variance = pairs.iter().map(|e| (e - mean).powi(2)).sum::<f64>() / count;
    (1.0 - count / image.depth_m.len() as f64, mean, variance.sqrt())
}

#[test]
fn every_name_is_a_sensor_that_makes_sense() {
    for name in Sensor::NAMES {
        Sensor::by_name(name).unwrap().check().unwrap();
    }
    assert_eq!(Sensor::by_name("pico-flexx"), Some(Sensor::pico_flexx()));
    assert_eq!(Sensor::by_name("webcam"), None);
}

#[test]
fn axial_noise_has_its_standard_deviation() {
    for sensor in [Sensor::azure_kinect(), Sensor::pico_flexx()].map(plain) {
        for (depth, albedo, specular, cos) in
            [(0.5, 0.6, 0.0, 1.0), (0.8, 0.3, 0.0, 0.8), (1.5, 0.8, 0.0, 0.5), (3.0, 0.9, 0.0, 1.0)]
        {
            let view = view(|_, _| depth, albedo, specular, cos);
            let (missing, mean, sigma) = errors(&sensor.observe(&view, 5), &view);
            let expected = sensor.sigma_m(depth, albedo, specular, cos);
            assert!((sigma / expected - 1.0).abs() < 0.05, "{sigma} m, expected {expected} m at {depth} m");
            assert_eq!(missing, 0.0);
            let bound =
                sensor.systematic.offset_m + sensor.systematic.scale * depth + sensor.systematic.wiggle_m;
            assert!(mean.abs() < bound, "{mean} m at {depth} m");
        }
    }
    // The sizes that the specifications promise, at their own conditions.
    assert!(Sensor::azure_kinect().sigma_m(3.86, 0.15, 0.0, 1.0) < 0.017);
    assert!((Sensor::pico_flexx().sigma_m(4.0, 1.0, 0.0, 1.0) / 4.0 - 0.01).abs() < 0.001);
}

#[test]
fn a_device_repeats_its_own_error() {
    let view = view(|_, _| 0.7, 0.6, 0.0, 1.0);
    let mean = |device: u64, seed: u64| {
        let mut sensor = plain(Sensor::azure_kinect());
        sensor.systematic.device = device;
        errors(&sensor.observe(&view, seed), &view).1
    };
    let means: Vec<f64> = (0..20).map(|device| mean(device, 1)).collect();
    for (device, first) in means.iter().enumerate() {
        assert!((mean(device as u64, 2) - first).abs() < 1e-4);
    }
    let spread =
        means.iter().copied().fold(f64::MIN, f64::max) - means.iter().copied().fold(f64::MAX, f64::min);
    assert!((0.004..0.0155).contains(&spread), "{spread} m");
}

#[test]
fn flat_angles_dark_and_shiny_surfaces_return_less() {
    let sensor = plain(Sensor::azure_kinect());
    let missing = |depth: f64, albedo: f64, specular: f64, cos: f64| {
        let view = view(|_, _| depth, albedo, specular, cos);
        errors(&sensor.observe(&view, 3), &view).0
    };
    let cos = |degrees: f64| degrees.to_radians().cos();
    // Flat angles: linear in the cosine.
    let (start, end) = (cos(sensor.grazing.start_deg), cos(sensor.grazing.end_deg));
    assert_eq!(missing(0.5, 0.9, 0.0, start + 0.001), 0.0);
    assert_eq!(missing(0.5, 0.9, 0.0, end - 0.001), 1.0);
    for share in [0.2, 0.5, 0.8] {
        let found = missing(0.5, 0.9, 0.0, start + (end - start) * share);
        assert!((found - share).abs() < 0.02, "{found} missing, expected {share}");
    }
    // Dark: half of the pixels return at the floor.
    let albedo = sensor.amplitude.floor * 4.0;
    assert!((missing(2.0, albedo, 0.0, 1.0) - 0.5).abs() < 0.02);
    assert_eq!((missing(2.0, albedo * 1.3, 0.0, 1.0), missing(2.0, albedo * 0.7, 0.0, 1.0)), (0.0, 1.0));
    // Too bright: white and very near.
    assert_eq!(missing(0.165, 1.0, 0.0, 1.0), 1.0);
    // Shiny: more when facing the camera.
    for (specular, cos) in [(0.2, 1.0f64), (0.5, 1.0), (0.5, 0.6)] {
        let expected = specular * (sensor.shiny.anywhere + sensor.shiny.facing * cos.powi(8));
        let found = missing(0.5, 0.9, specular, cos);
        assert!((found - expected).abs() < 0.02, "{found} missing, expected {expected}");
    }
}

#[test]
fn edges_have_a_band_of_flying_pixels() {
    for reach in [0, 1, 2] {
        let mut sensor = plain(Sensor::azure_kinect());
        sensor.edges.reach_px = reach;
        sensor.systematic = Sensor::ideal(LENS).systematic;
        let (near, far) = (0.6, 0.9);
        // The edge is between columns 79 and 80.
        let view = view(|u, _| if u < 80 { near } else { far }, 0.9, 0.0, 1.0);
        let (mut dropped, mut flying, mut count) = (0, Vec::new(), 0);
        // Many exposures of the same edge.
        for seed in 0..40 {
            let image = sensor.observe(&view, seed);
            for (i, z) in image.depth_m.iter().enumerate() {
                let (u, v) = (i % LENS.width, i / LENS.width);
                let inside = (80 - reach..80 + reach).contains(&u) && (1..LENS.height - 1).contains(&v);
                if inside {
                    count += 1;
                    if *z == 0.0 { dropped += 1 } else { flying.push(f64::from(*z)) }
                } else if (4..156).contains(&u) && !(70..90).contains(&u) {
                    let exact = if u < 80 { near } else { far };
                    assert!((f64::from(*z) - exact).abs() < 0.008, "{z} m at column {u}");
                }
            }
        }
        if reach == 0 {
            continue;
        }
        let share = f64::from(dropped) / f64::from(count);
        assert!((share - sensor.edges.drop).abs() < 0.02, "{share} dropped");
        // Uniform between the two sides: mean in the middle, a quarter in each quarter.
        let mean = flying.iter().sum::<f64>() / flying.len() as f64;
        assert!((mean - 0.75).abs() < 0.005, "{mean}");
        let quarter = flying.iter().filter(|z| **z < 0.675).count() as f64 / flying.len() as f64;
        assert!((quarter - 0.25).abs() < 0.03, "{quarter}");
    }
}

#[test]
fn slanted_planes_have_no_edges_and_keep_their_depth() {
    let mut sensor = plain(Sensor::azure_kinect());
    sensor.systematic = Sensor::ideal(LENS).systematic;
    sensor.axial.floor_m = 0.0;
    sensor.axial.linear = 0.0;
    // A plane so steep that neighbours differ by more than the step of an edge.
    let plane = |u: usize, _: usize| 1.0 / (1.3 - 0.0065 * u as f64);
    sensor.lateral = Lateral { blur: 0.2, jitter_px: 0.0 };
    let slanted = view(plane, 0.9, 0.0, 1.0);
    assert!(slanted.depth_m.windows(2).any(|w| w[1] - w[0] > 0.03));
    let (missing, mean, sigma) = errors(&sensor.observe(&slanted, 1), &slanted);
    assert!(missing == 0.0 && mean.abs() < 1e-5 && sigma < 1e-5, "{missing} {mean} {sigma}");
    // With jitter, the error is the depth change per pixel times the jitter.
    sensor.lateral = Lateral { blur: 0.0, jitter_px: 0.3 };
    let gentle = view(|u, _| 1.0 / (1.2 - 0.002 * u as f64), 0.9, 0.0, 1.0);
    let image = sensor.observe(&gentle, 1);
    let (mut squares, mut count) = (0.0, 0.0);
    for v in 1..LENS.height - 1 {
        for u in 1..LENS.width - 1 {
            let i = v * LENS.width + u;
            let slope = 0.002 * f64::from(gentle.depth_m[i]).powi(2);
            squares += (f64::from(image.depth_m[i] - gentle.depth_m[i]) / slope).powi(2);
            count += 1.0;
        }
    }
    let jitter = f64::sqrt(squares / count);
    assert!((jitter / 0.3 - 1.0).abs() < 0.03, "{jitter} px");
}

#[test]
fn depths_are_whole_steps_and_only_the_lit_hexagon_returns() {
    let sensor = Sensor::azure_kinect();
    let pixels = sensor.lens.width * sensor.lens.height;
    let view = View {
        lens: sensor.lens,
        world_from_camera: Isometry3::identity(),
        depth_m: vec![0.8; pixels],
        instance: vec![0; pixels],
        cos_incidence: vec![1.0; pixels],
        albedo: vec![0.5; pixels],
        specular: vec![0.0; pixels],
    };
    let image = sensor.observe(&view, 11);
    for z in &image.depth_m {
        let steps = f64::from(*z) / sensor.quantum_m;
        assert!((steps - steps.round()).abs() < 1e-3, "{z} m");
    }
    let at = |u: usize, v: usize| image.depth_m[v * 640 + u];
    assert_eq!([at(0, 0), at(639, 0), at(0, 575), at(639, 575)], [0.0; 4]);
    assert!([at(320, 0), at(320, 575), at(0, 300), at(639, 300), at(320, 288)].iter().all(|z| *z > 0.0));
    let share = image.depth_m.iter().filter(|z| **z > 0.0).count() as f64 / pixels as f64;
    assert!((0.80..0.88).contains(&share), "{share} of the image is lit");
}

#[test]
fn a_seed_is_an_image_and_another_is_another() {
    let view = view(|u, v| 0.6 + 0.001 * (u + v) as f64, 0.5, 0.3, 0.9);
    let sensor = Sensor { lens: LENS, ..Sensor::azure_kinect() };
    assert_eq!(sensor.observe(&view, 1), sensor.observe(&view, 1));
    let (a, b) = (sensor.observe(&view, 1), sensor.observe(&view, 2));
    let same = a.depth_m.iter().zip(&b.depth_m).filter(|(a, b)| a == b && **a > 0.0).count();
    assert!(same < a.depth_m.len() / 2, "{same} equal");
    // Rows do not repeat one another, nor does the next row in the next seed.
    let flat = self::view(|_, _| 0.7, 0.5, 0.0, 1.0);
    let (a, b) = (plain(sensor.clone()).observe(&flat, 1), plain(sensor).observe(&flat, 2));
    let row = |image: &DepthImage, v: usize| image.depth_m[v * LENS.width..(v + 1) * LENS.width].to_vec();
    assert!(row(&a, 0) != row(&a, 1) && row(&a, 1) != row(&b, 0) && row(&a, 0) != row(&b, 1));
}

#[test]
fn without_faults_the_view_is_returned() {
    let view = view(|u, v| if u > 100 { f64::NAN } else { 0.5 + 0.01 * v as f64 }, 0.0, 1.0, 0.01);
    let image = Sensor::ideal(LENS).observe(&view, 1);
    for (z, exact) in image.depth_m.iter().zip(&view.depth_m) {
        assert!(if exact.is_nan() { *z == 0.0 } else { z == exact }, "{z} {exact}");
    }
}

#[test]
fn configurations_survive_as_text_and_are_checked() {
    for sensor in [Sensor::azure_kinect(), Sensor::pico_flexx(), Sensor::ideal(LENS)] {
        sensor.check().unwrap();
        let text = serde_json::to_string(&sensor).unwrap();
        assert_eq!(serde_json::from_str::<Sensor>(&text).unwrap(), sensor);
        let unknown = text.replacen("\"quantum_m\"", "\"quantum_mm\"", 1);
        assert!(serde_json::from_str::<Sensor>(&unknown).unwrap_err().to_string().contains("quantum_mm"));
    }
    let mut sensor = Sensor::azure_kinect();
    sensor.edges.drop = f64::NAN;
    assert_eq!(sensor.check().unwrap_err().field, "edges.drop");
    sensor = Sensor::azure_kinect();
    sensor.grazing.end_deg = 10.0;
    assert_eq!(
        sensor.check().unwrap_err().to_string(),
        "grazing.end_deg: found 10, expected start_deg to 90 degrees"
    );
}

#[test]
fn a_view_whose_lists_do_not_fit_has_no_returns() {
    let mut broken = view(|_, _| 0.7, 0.5, 0.0, 1.0);
    broken.albedo.pop();
    let image = Sensor::azure_kinect().observe(&broken, 1);
    assert_eq!(image.depth_m, vec![0.0; LENS.width * LENS.height]);
}

fn anything() -> impl Strategy<Value = f64> {
    prop_oneof![
        4 => -1.0..2.0f64,
        1 => prop_oneof![Just(f64::NAN), Just(f64::INFINITY), Just(-1e30), Just(1e30), Just(0.0), Just(1e-30)],
    ]
}

proptest! {
    #[test]
    fn no_configuration_and_no_view_make_it_panic(
        x in [anything(), anything(), anything(), anything(), anything(), anything()],
        y in [anything(), anything(), anything(), anything(), anything(), anything()],
        depths in prop::collection::vec(anything(), 48),
        light in [anything(), anything(), anything()],
        reach in prop_oneof![0..4usize, Just(usize::MAX)],
        seed: u64,
    ) {
        let lens = Pinhole { width: 8, height: 6, ..LENS };
        let sensor = Sensor {
            lens,
            range: Range { nearest_m: x[0], farthest_m: x[1] },
            amplitude: Amplitude { floor: x[2], fade: x[3], ceiling: x[4] },
            axial: Axial { floor_m: x[5], linear: y[0], quadratic: y[1], cap_m: y[2] },
            systematic: Systematic { device: seed, offset_m: y[3], scale: y[4], wiggle_m: y[5], wiggle_period_m: x[0] },
            lateral: Lateral { blur: x[1], jitter_px: x[2] },
            edges: Edges { step_m: x[3], reach_px: reach, drop: x[4] },
            grazing: Grazing { start_deg: x[5], end_deg: y[0] },
            shiny: Shiny { anywhere: y[1], facing: y[2] },
            illumination: vec![[y[3], y[4]], [y[5], x[0]], [x[1], x[2]]],
            quantum_m: x[3],
        };
        let view = View {
            lens,
            world_from_camera: Isometry3::identity(),
            depth_m: depths.iter().map(|z| *z as f32).collect(),
            instance: vec![0; 48],
            cos_incidence: vec![light[0] as f32; 48],
            albedo: vec![light[1] as f32; 48],
            specular: vec![light[2] as f32; 48],
        };
        let image = sensor.observe(&view, seed);
        prop_assert!(image.depth_m.iter().all(|z| *z >= 0.0), "{:?}", image);
    }
}
