//! Requests with any numbers in them: nothing panics, and what is accepted is sound.

use proptest::prelude::*;

use super::*;

fn any_number() -> impl Strategy<Value = f64> {
    prop_oneof![any::<f64>(), -2.0..2.0f64, Just(0.0), Just(1.0)]
}

fn any_vector() -> impl Strategy<Value = Option<v1::Vector3>> {
    proptest::option::of((any_number(), any_number(), any_number()).prop_map(|(x, y, z)| v1::Vector3 {
        x,
        y,
        z,
    }))
}

fn any_pose() -> impl Strategy<Value = Option<v1::Pose>> {
    let rotation = (any_number(), any_number(), any_number(), any_number());
    (any_vector(), proptest::option::of(rotation)).prop_map(|(position, rotation)| {
        let orientation = rotation.map(|(x, y, z, w)| v1::Quaternion { x, y, z, w });
        Some(v1::Pose { position, orientation })
    })
}

prop_compose! {
    fn any_frame()(
        size in (-2i32..6, -2i32..6),
        encoding in -1i32..6,
        depth_scale_m in any_number(),
        data in proptest::collection::vec(any::<u8>(), 0..80),
        focal in (any_number(), any_number(), any_number(), any_number()),
        distortion in proptest::collection::vec(any_number(), 0..10),
        camera in any_pose(),
        labels in proptest::option::of((-1i32..4, proptest::collection::vec(any::<u8>(), 0..30))),
    ) -> v1::DepthFrame {
        let (fx_px, fy_px, cx_px, cy_px) = focal;
        v1::DepthFrame {
            width_px: size.0,
            height_px: size.1,
            encoding,
            depth_scale_m,
            data: data.into(),
            intrinsics: Some(v1::CameraIntrinsics { fx_px, fy_px, cx_px, cy_px, distortion }),
            camera_pose: camera.map(|pose| v1::PoseInFrame { frame_id: String::new(), pose: Some(pose) }),
            labels: labels.map(|(encoding, data)| v1::LabelImage { encoding, data: data.into() }),
            ..Default::default()
        }
    }
}

prop_compose! {
    fn any_options()(
        numbers in (any::<i32>(), any::<i32>(), any::<i32>(), any::<i32>(), -1i32..7),
        shares in proptest::collection::vec(proptest::option::of(any_number()), 7),
        direction in any_vector(),
        keep_out in any_pose(),
        extents in any_vector(),
        label in any::<i32>(),
        budget in (any::<i64>(), any::<i32>()),
        seed in any::<u64>(),
    ) -> v1::PlanOptions {
        v1::PlanOptions {
            batch_size: numbers.0,
            scheme: Some(v1::Scheme { iteration_count: numbers.1, penetration_iteration_count: numbers.2 }),
            reaching: numbers.4,
            reaching_direction: direction,
            orientation_limits: Some(v1::OrientationLimits {
                max_tilt_rad: shares[0],
                roll: shares[1].map(|a| v1::RollRange { min_rad: a, max_rad: shares[2].unwrap_or(a) }),
            }),
            keep_out_boxes: vec![v1::KeepOutBox { pose: keep_out, half_extents_m: extents }],
            target: Some(v1::plan_options::Target::TargetLabel(label)),
            seed,
            budget: Some(prost_types::Duration { seconds: budget.0, nanos: budget.1 }),
            max_grasp_count: numbers.3,
            min_score: shares[3],
            friction: shares[4],
            pregrasp_offset_m: shares[5],
            opening_fraction: shares[6],
            trace: false,
            priority: numbers.4,
            require_complete: numbers.0 % 2 == 0,
        }
    }
}

proptest! {
    #[test]
    fn no_frame_panics_and_what_is_accepted_is_sound(wire in any_frame()) {
        let request = v1::PlanGraspsRequest { frames: vec![wire], ..request() };
        if let Ok(Parsed { scene, .. }) = plan_grasps(request, "") {
            let frame = &scene.frames[0];
            if let Some(pose) = frame.world_from_camera {
                prop_assert!((pose.rotation.norm() - 1.0).abs() < 1e-9);
                prop_assert!(pose.translation.vector.iter().all(|v| v.is_finite()));
            }
            if let Ok((decoded, _)) = frame.decode() {
                let pixels = decoded.image.width * decoded.image.height;
                prop_assert_eq!(decoded.image.depth_m.len(), pixels);
                prop_assert!(decoded.labels.is_none_or(|l| l.len() == pixels));
                prop_assert!(decoded.intrinsics.fx_px > 0.0 && decoded.intrinsics.fy_px > 0.0);
            }
        }
    }

    #[test]
    fn no_options_panic_and_what_is_accepted_is_in_range(wire in any_options(), hand in ".{0,40}") {
        let mut request = request();
        request.frames[0].labels = Some(v1::LabelImage { encoding: 1, data: vec![0; 8].into() });
        plan_grasps(v1::PlanGraspsRequest { hand, ..request.clone() }, "").ok();
        request.options = Some(wire);
        if let Ok(Parsed { jobs: job, .. }) = plan_grasps(request, "") {
            let options = job.options;
            prop_assert!((1..=4096).contains(&options.batch));
            prop_assert!(options.scheme.with_penetration <= options.scheme.iterations);
            prop_assert!(options.friction > 0.0 && options.friction <= 5.0);
            prop_assert!(job.budget.is_none_or(|b| !b.is_zero()));
        }
    }
}
