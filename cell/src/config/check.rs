//! What the values of `cell.toml` must be.

use super::{CellConfig, ConfigError};

/// Hands reach so far sideways from their tool point, metres.
const HAND_RADIUS_M: f64 = 0.1;

impl CellConfig {
    /// Checks every value.
    ///
    /// # Errors
    /// [`ConfigError::Value`] with the first field that is wrong, what was found and what was expected.
    pub fn check(&self) -> Result<(), ConfigError> {
        self.check_planner()?;
        self.check_places()?;
        for (device, settings) in
            [("camera", &self.camera.settings), ("arm", &self.arm.settings), ("hand", &self.hand.settings)]
        {
            if let Some((key, value)) = settings.iter().find(|(_, value)| !value.is_table()) {
                let field = format!("{device}.settings.{key}");
                let expected =
                    format!("a table for each kind of {device}, for example [{device}.settings.mock]");
                return Err(wrong(&field, value, expected));
            }
        }
        self.check_servo()?;
        let share = |field, x: f64| inside(field, x, x > 0.0 && x <= 1.0, "more than 0, at most 1");
        share("hand.speed", self.hand.speed)?;
        share("hand.force", self.hand.force)?;
        positive("camera.max_age_s", self.camera.max_age_s, 3600.0)?;
        positive("arm.speed_m_s", self.arm.speed_m_s, 10.0)?;
        positive("arm.acceleration_m_s2", self.arm.acceleration_m_s2, 100.0)?;
        positive("arm.approach_speed_m_s", self.arm.approach_speed_m_s, 10.0)?;
        positive("arm.lift_speed_m_s", self.arm.lift_speed_m_s, 10.0)?;
        positive("hand.meet_s", self.hand.meet_s, 60.0)?;
        positive("arm.carry_speed_m_s", self.arm.carry_speed_m_s, 10.0)?;
        let t = &self.timeouts;
        for (field, value) in [
            ("timeouts.capture_s", t.capture_s),
            ("timeouts.plan_s", t.plan_s),
            ("timeouts.move_s", t.move_s),
            ("timeouts.grip_s", t.grip_s),
            ("timeouts.state_s", t.state_s),
            ("timeouts.clear_s", t.clear_s),
            ("recovery.longest_backoff_s", self.recovery.longest_backoff_s),
        ] {
            positive(field, value, 3600.0)?;
        }
        inside("timeouts.patience", t.patience, (1.0..=1000.0).contains(&t.patience), "1 to 1000")?;
        let r = &self.recovery;
        let short = r.backoff_s > 0.0 && r.backoff_s <= r.longest_backoff_s;
        inside("recovery.backoff_s", r.backoff_s, short, "more than 0, at most recovery.longest_backoff_s")?;
        count("recovery.tries", r.tries, 0..=1000)?;
        // The first may be asked with a floor told too high, under which flat things disappear; the second never is.
        count("recovery.empty_frames", r.empty_frames, 2..=1000)?;
        count("recovery.no_grasp_frames", r.no_grasp_frames, 1..=1000)?;
        count("recovery.failures_in_a_row", r.failures_in_a_row, 1..=10_000)?;
        count("run.trials", self.run.trials, 1..=1_000_000)?;
        positive("run.time_limit_s", self.run.time_limit_s, 1e7)
    }

    fn check_planner(&self) -> Result<(), ConfigError> {
        let p = &self.planner;
        if !p.embedded && p.endpoint.is_empty() {
            return Err(wrong(
                "planner.endpoint",
                "an empty text",
                "an address such as http://127.0.0.1:50051",
            ));
        }
        if self.hand.id.is_empty() || self.hand.id.contains('/') {
            return Err(wrong(
                "hand.id",
                format!("{:?}", self.hand.id),
                "the id of a hand, for example leap",
            ));
        }
        count("planner.batch", p.batch, 1..=4096)?;
        count("planner.scheme[0]", p.scheme[0], 1..=10_000)?;
        count("planner.scheme[1]", p.scheme[1], 0..=p.scheme[0])?;
        count("planner.max_grasps", p.max_grasps, 1..=1000)?;
        inside("planner.min_score", p.min_score, (0.0..=1.0).contains(&p.min_score), "0 to 1")?;
        positive("planner.friction", p.friction, 5.0)?;
        positive("planner.pregrasp_offset_m", p.pregrasp_offset_m, 1.0)?;
        let tilt = p.max_tilt_rad.unwrap_or(0.0);
        inside("planner.max_tilt_rad", tilt, (0.0..=std::f64::consts::PI).contains(&tilt), "0 to pi")
    }

    fn check_servo(&self) -> Result<(), ConfigError> {
        let Some(s) = &self.servo else { return Ok(()) };
        point("servo.eye_m", &s.eye_m)?;
        point("servo.looks_at_m", &s.looks_at_m)?;
        count("servo.iterations", s.iterations, 1..=100)?;
        count("servo.frames_under_way", s.frames_under_way, 1..=4)?;
        count("servo.lost_answers", s.lost_answers, 1..=1000)?;
        let start = s.standoff_start_m;
        inside("servo.standoff_start_m", start, (0.01..=0.5).contains(&start), "0.01 to 0.5")?;
        let end = s.standoff_end_m;
        inside("servo.standoff_end_m", end, (0.0..=start).contains(&end), "0 to servo.standoff_start_m")?;
        let shrink = s.standoff_speed_m_s;
        inside("servo.standoff_speed_m_s", shrink, (0.001..=1.0).contains(&shrink), "0.001 to 1")?;
        positive("servo.speed_m_s", s.speed_m_s, 10.0)?;
        positive("servo.silence_s", s.silence_s, 60.0)?;
        let patient = s.answer_s >= s.silence_s && s.answer_s <= 600.0;
        inside("servo.answer_s", s.answer_s, patient, "servo.silence_s to 600")?;
        positive("servo.longest_s", s.longest_s, 3600.0)?;
        if let Some(pose) = &s.hand_from_camera {
            point("servo.hand_from_camera.position_m", &pose.position_m)?;
            let norm = pose.orientation_xyzw.iter().map(|c| c * c).sum::<f64>().sqrt();
            let unit = (norm - 1.0).abs() < 1e-3;
            inside("servo.hand_from_camera.orientation_xyzw", norm, unit, "a quaternion of length 1")?;
        }
        Ok(())
    }

    fn check_places(&self) -> Result<(), ConfigError> {
        let t = &self.tray;
        point("tray.position_m", &t.position_m)?;
        point("drop.position_m", &self.drop.position_m)?;
        point("camera.position_m", &self.camera.position_m)?;
        point("camera.looks_at_m", &self.camera.looks_at_m)?;
        if let Some(wait) = &self.motion.wait_position_m {
            point("motion.wait_position_m", wait)?;
        }
        inside("tray.yaw_rad", t.yaw_rad, t.yaw_rad.abs() <= 7.0, "-7 to 7")?;
        inside("drop.yaw_rad", self.drop.yaw_rad, self.drop.yaw_rad.abs() <= 7.0, "-7 to 7")?;
        inside("tray.volume_m", t.volume_m, (0.1..=2.0).contains(&t.volume_m), "0.1 to 2")?;
        for (field, value) in [("tray.width_m", t.width_m), ("tray.length_m", t.length_m)] {
            let fits = value > 0.02 && value <= t.volume_m;
            inside(field, value, fits, "more than 0.02, at most tray.volume_m, the edge of the volume")?;
        }
        inside(
            "tray.wall_clearance_m",
            t.wall_clearance_m,
            t.wall_clearance_m >= 0.0 && 2.0 * t.wall_clearance_m < t.width_m.min(t.length_m),
            "0 or more, less than half the tray",
        )?;
        let wall = t.wall_height_m;
        inside(
            "tray.wall_height_m",
            wall,
            (0.0..=t.volume_m).contains(&wall),
            "0 (no walls) to tray.volume_m",
        )?;
        inside("tray.wall_m", t.wall_m, (0.0005..=0.05).contains(&t.wall_m), "0.0005 to 0.05")?;
        let floor = t.floor_clearance_m;
        inside("tray.floor_clearance_m", floor, (0.0..=0.05).contains(&floor), "0 to 0.05")?;
        positive("tray.height_m", t.height_m, t.volume_m)?;
        positive("motion.travel_height_m", self.motion.travel_height_m, 5.0)?;
        positive("motion.contact_force_n", self.motion.contact_force_n, 1000.0)?;
        positive("motion.lift_m", self.motion.lift_m, 2.0)?;
        // What is dropped falls, from whatever height. The tray with its walls ends nearer to the volume than this.
        let drop = &self.drop.position_m;
        let beside = |[x, y, _]: [f64; 3]| x.hypot(y) >= HAND_RADIUS_M;
        let expected = format!(
            "a place at least {HAND_RADIUS_M} m beside the tray's volume, else what is dropped is picked again and the \
             hand that waits there is seen as a thing to grasp"
        );
        inside("drop.position_m", format!("{drop:?}"), beside(t.outside_volume(drop)), &expected)?;
        let Some(wait) = &self.motion.wait_position_m else { return Ok(()) };
        // The hand points down: all of it is above its tool point.
        let away = beside(t.outside_volume(wait)) || t.outside_volume(wait)[2] > 0.0;
        let expected = format!(
            "a place above the tray's volume, or at least {HAND_RADIUS_M} m beside it, else the hand is seen as a thing \
             to grasp"
        );
        inside("motion.wait_position_m", format!("{wait:?}"), away, &expected)
    }
}

fn wrong(field: &str, found: impl ToString, expected: impl ToString) -> ConfigError {
    ConfigError::Value { field: field.to_owned(), found: found.to_string(), expected: expected.to_string() }
}

fn inside(field: &str, found: impl ToString, ok: bool, expected: &str) -> Result<(), ConfigError> {
    if ok { Ok(()) } else { Err(wrong(field, found, expected)) }
}

fn positive(field: &str, value: f64, most: f64) -> Result<(), ConfigError> {
    let ok = value > 0.0 && value <= most;
    inside(field, value, ok, &format!("a number above 0, at most {most}"))
}

fn count(field: &str, value: u32, range: std::ops::RangeInclusive<u32>) -> Result<(), ConfigError> {
    inside(field, value, range.contains(&value), &format!("{} to {}", range.start(), range.end()))
}

fn point(field: &str, value: &[f64; 3]) -> Result<(), ConfigError> {
    let ok = value.iter().all(|x| x.is_finite() && x.abs() <= 100.0);
    inside(field, format!("{value:?}"), ok, "three numbers of metres, each within 100")
}
