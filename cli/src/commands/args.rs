//! Flags that say how a scene is read and how grasps are searched, shared by the commands that plan.

use std::str::FromStr;
use std::time::Duration;

use clap::Args;
use graspd_planner::grid::Grid;
use graspd_planner::options::{
    KeepOut, OrientationLimits, PlanOptions, Reaching, Region, SceneOptions, Scheme, Target, VolumeKind,
    WorkspaceRequest,
};
use nalgebra::{Isometry3, Point3, Translation3, Unit, UnitQuaternion, Vector3};

use crate::estimators::EstimatorArgs;

/// How the scene is read.
#[derive(Debug, Clone, Args)]
#[command(next_help_heading = "Scene")]
pub(crate) struct SceneArgs {
    /// What the volume stores: tsdf or occupancy
    #[arg(long, default_value = "tsdf", value_parser = parse_volume)]
    volume: VolumeKind,
    /// T_fc: focal contacts exceed this share of the largest certainty, 0 to 1
    #[arg(long, default_value_t = 0.7, value_name = "SHARE", value_parser = parse_share)]
    t_fc: f64,
    /// T_fe: focal centroids exceed this share of the largest centroid score, 0 to 1
    #[arg(long, default_value_t = 0.95, value_name = "SHARE", value_parser = parse_share)]
    t_fe: f64,
    /// Edge length of the volume, metres
    #[arg(long, default_value_t = 0.4, value_name = "METRES", value_parser = parse_size)]
    volume_size: f64,
    /// Voxels along each edge of the volume
    #[arg(long, default_value_t = 80, value_name = "VOXELS", value_parser = clap::value_parser!(u32).range(16..=128))]
    volume_resolution: u32,
    /// Corner of the volume in the world, metres, and its yaw in degrees; found from the table if left out
    #[arg(long, value_name = "X,Y,Z[,YAW]", allow_hyphen_values = true)]
    workspace: Option<Numbers<3, 4>>,
    /// Height of the table top in the cube, metres; only with --workspace
    #[arg(long, value_name = "METRES", requires = "workspace")]
    table_height: Option<f64>,
    /// Grasp only inside this box: centre, half extents and yaw in degrees; what is outside stays an obstacle
    #[arg(long, value_name = "X,Y,Z,HX,HY,HZ[,YAW]", allow_hyphen_values = true)]
    region: Option<Numbers<6, 7>>,
    #[command(flatten)]
    estimator: EstimatorArgs,
}

impl SceneArgs {
    /// The contact estimators, and which of them.
    pub(crate) fn estimator(&self) -> &EstimatorArgs {
        &self.estimator
    }

    /// As the planner wants it.
    pub(crate) fn options(&self) -> SceneOptions {
        let workspace = match &self.workspace {
            None => WorkspaceRequest::Auto,
            Some(numbers) => {
                WorkspaceRequest::Placed { world_from_volume: numbers.pose(), table_m: self.table_height }
            }
        };
        SceneOptions {
            volume: self.volume,
            grid: Grid { resolution: self.volume_resolution as usize, size_m: self.volume_size },
            workspace,
            region: self.region.as_ref().map(|numbers| {
                let (world_from_box, half_extents_m) = numbers.solid_box();
                Region { world_from_box, half_extents_m }
            }),
            focal_contact_threshold: self.t_fc,
            focal_centroid_threshold: self.t_fe,
        }
    }
}

/// How grasps are searched.
#[derive(Debug, Clone, Args)]
#[command(next_help_heading = "Search")]
pub(crate) struct SearchArgs {
    /// Candidates that are optimized together (N_batch)
    #[arg(long, default_value_t = 48, value_parser = clap::value_parser!(u32).range(1..=4096))]
    batch: u32,
    /// Iterations, and how many of the last ones avoid penetration
    #[arg(long, default_value = "200,40", value_name = "ALL,LAST", value_parser = parse_scheme)]
    scheme: Scheme,
    /// Same seed, same frame, same hand: same answer
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Direction along which hands reach: top-down, camera, free, or a direction x,y,z in the world
    #[arg(long, default_value = "top-down", allow_hyphen_values = true, value_parser = parse_reaching)]
    reaching: Reaching,
    /// Largest angle between the hand's approach and the reaching direction (with free: straight down), degrees; 0
    /// for a 4-axis robot; 60 if left out, 74 with free
    #[arg(long, value_name = "DEGREES")]
    cone_deg: Option<f64>,
    /// Allowed rotation about the reaching direction, degrees
    #[arg(long, value_name = "MIN,MAX", allow_hyphen_values = true)]
    roll_deg: Option<Numbers<2, 2>>,
    /// A box that no part of the hand may enter: centre, half extents and yaw in degrees; may be repeated
    #[arg(long, value_name = "X,Y,Z,HX,HY,HZ[,YAW]", allow_hyphen_values = true)]
    keep_out: Vec<Numbers<6, 7>>,
    /// Grasp only what is within R metres of this point of the world
    #[arg(long, value_name = "X,Y,Z,R", allow_hyphen_values = true, conflicts_with = "target_label")]
    target_point: Option<Numbers<4, 4>>,
    /// Grasp only the object with this label in the label image
    #[arg(long, value_name = "LABEL", value_parser = clap::value_parser!(u8).range(1..))]
    target_label: Option<u8>,
    /// At most this many grasps for each hand
    #[arg(long, default_value_t = 10, value_parser = clap::value_parser!(u32).range(1..=1000))]
    max_grasps: u32,
    /// Leave out grasps that score less, 0 to 1
    #[arg(long, default_value_t = 0.0, value_parser = parse_share)]
    min_score: f64,
    /// Stop after this many milliseconds and answer with the best so far. Counts from the start of the request,
    /// here as on a server: reading the scene is included, and all hands of the request share the time
    #[arg(long, value_name = "MS", value_parser = clap::value_parser!(u64).range(1..))]
    budget_ms: Option<u64>,
    /// Coulomb friction between pads and objects
    #[arg(long, default_value_t = 0.5)]
    friction: f64,
    /// Distance of the pre-grasp from the grasp along the approach, metres
    #[arg(long, default_value_t = 0.10, value_name = "METRES")]
    pregrasp_offset: f64,
    /// Initial joints lie within this share of the closing range
    #[arg(long, default_value_t = 0.2, value_name = "SHARE", value_parser = parse_share)]
    opening: f64,
    /// Return the objective's terms of every iteration too
    #[arg(long, requires = "json")]
    trace: bool,
}

impl SearchArgs {
    /// As the planner wants it.
    ///
    /// # Errors
    /// For a value outside its range, naming the flag.
    pub(crate) fn options(&self) -> anyhow::Result<PlanOptions> {
        let within = |flag: &str, value: f64, low: f64, high: f64| {
            anyhow::ensure!((low..=high).contains(&value), "{flag}: found {value}, expected {low} to {high}");
            Ok(value)
        };
        let roll_rad = match &self.roll_deg {
            None => None,
            Some(Numbers(v)) => {
                anyhow::ensure!(
                    v[0] <= v[1],
                    "--roll-deg: found {},{}, expected MIN not above MAX",
                    v[0],
                    v[1]
                );
                Some((v[0].to_radians(), v[1].to_radians()))
            }
        };
        let keep_out = self.keep_out.iter().map(keep_out).collect::<anyhow::Result<_>>()?;
        let target = match (&self.target_point, self.target_label) {
            (Some(Numbers(v)), _) => {
                anyhow::ensure!(
                    v[3] > 0.0,
                    "--target-point: found a radius of {}, expected more than 0",
                    v[3]
                );
                Some(Target::Point { point: Point3::new(v[0], v[1], v[2]), radius_m: v[3] })
            }
            (None, Some(label)) => Some(Target::Label(label)),
            (None, None) => None,
        };
        let cone_rad = match self.cone_deg {
            Some(degrees) => within("--cone-deg", degrees, 0.0, 180.0)?.to_radians(),
            None => OrientationLimits::default_cone_rad(&self.reaching),
        };
        Ok(PlanOptions {
            batch: self.batch as usize,
            scheme: self.scheme,
            reaching: self.reaching,
            orientation: OrientationLimits { cone_rad, roll_rad },
            keep_out,
            target,
            seed: self.seed,
            max_grasps: self.max_grasps as usize,
            min_score: self.min_score,
            opening_fraction: within("--opening", self.opening, 1e-6, 1.0)?,
            friction: within("--friction", self.friction, 1e-6, 5.0)?,
            pregrasp_offset_m: within("--pregrasp-offset", self.pregrasp_offset, 0.0, 1.0)?,
            trace: self.trace,
        })
    }

    /// The label that is asked for.
    pub(crate) fn wants_labels(&self) -> Option<u8> {
        self.target_label
    }

    /// Time for the whole request, where it is bounded.
    pub(crate) fn budget(&self) -> Option<Duration> {
        self.budget_ms.map(Duration::from_millis)
    }
}

fn keep_out(numbers: &Numbers<6, 7>) -> anyhow::Result<KeepOut> {
    let (world_from_box, half_extents_m) = numbers.solid_box();
    anyhow::ensure!(
        half_extents_m.min() > 0.0,
        "--keep-out: found half extents {half_extents_m:?}, expected each above 0"
    );
    Ok(KeepOut { world_from_box, half_extents_m })
}

fn yawed([x, y, z]: [f64; 3], yaw_deg: f64) -> Isometry3<f64> {
    let rotation = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), yaw_deg.to_radians());
    Isometry3::from_parts(Translation3::new(x, y, z), rotation)
}

/// Between `LEAST` and `MOST` finite numbers, separated by commas.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Numbers<const LEAST: usize, const MOST: usize>(pub(crate) Vec<f64>);

impl<const LEAST: usize, const MOST: usize> FromStr for Numbers<LEAST, MOST> {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let expected =
            if LEAST == MOST { format!("{LEAST} numbers") } else { format!("{LEAST} to {MOST} numbers") };
        let numbers: Option<Vec<f64>> =
            text.split(',').map(|s| s.trim().parse().ok().filter(|x: &f64| x.is_finite())).collect();
        let numbers = numbers.ok_or_else(|| format!("expected {expected} separated by commas"))?;
        if (LEAST..=MOST).contains(&numbers.len()) {
            Ok(Self(numbers))
        } else {
            Err(format!("found {} numbers, expected {expected}", numbers.len()))
        }
    }
}

impl Numbers<3, 4> {
    fn pose(&self) -> Isometry3<f64> {
        yawed([self.0[0], self.0[1], self.0[2]], self.0.get(3).copied().unwrap_or(0.0))
    }
}

impl Numbers<6, 7> {
    /// Pose and half extents of a box: centre, half extents and yaw in degrees.
    fn solid_box(&self) -> (Isometry3<f64>, Vector3<f64>) {
        let [x, y, z, hx, hy, hz] = std::array::from_fn(|i| self.0.get(i).copied().unwrap_or(0.0));
        (yawed([x, y, z], self.0.get(6).copied().unwrap_or(0.0)), Vector3::new(hx, hy, hz))
    }
}

pub(super) fn parse_volume(text: &str) -> Result<VolumeKind, String> {
    match text {
        "tsdf" => Ok(VolumeKind::Tsdf),
        "occupancy" => Ok(VolumeKind::Occupancy),
        _ => Err("expected tsdf or occupancy".into()),
    }
}

pub(crate) fn parse_share(text: &str) -> Result<f64, String> {
    text.parse()
        .ok()
        .filter(|x| (0.0..=1.0).contains(x))
        .ok_or_else(|| "expected a number from 0 to 1".into())
}

fn parse_size(text: &str) -> Result<f64, String> {
    text.parse()
        .ok()
        .filter(|x| (0.1..=2.0).contains(x))
        .ok_or_else(|| "expected a number from 0.1 to 2".into())
}

pub(super) fn parse_scheme(text: &str) -> Result<Scheme, String> {
    let expected =
        "expected two whole numbers: all iterations (1 to 10000), the last of them with penetration";
    let parts: Option<Vec<usize>> = text.split(',').map(|s| s.trim().parse().ok()).collect();
    match parts.as_deref() {
        Some(&[iterations, with_penetration])
            if (1..=10_000).contains(&iterations) && with_penetration <= iterations =>
        {
            Ok(Scheme { iterations, with_penetration })
        }
        _ => Err(expected.into()),
    }
}

fn parse_reaching(text: &str) -> Result<Reaching, String> {
    match text {
        "top-down" => Ok(Reaching::TopDown),
        "camera" => Ok(Reaching::CameraRay),
        "free" => Ok(Reaching::Free),
        _ => {
            let expected = "expected top-down, camera, free, or a direction x,y,z";
            let numbers: Numbers<3, 3> = text.parse().map_err(|_| expected.to_owned())?;
            let direction = Vector3::new(numbers.0[0], numbers.0[1], numbers.0[2]);
            Unit::try_new(direction, 1e-9)
                .map(Reaching::Direction)
                .ok_or_else(|| "expected a direction that is not zero".into())
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;

    #[derive(Debug, Parser)]
    struct Both {
        #[command(flatten)]
        scene: SceneArgs,
        #[command(flatten)]
        search: SearchArgs,
        // What flags refer to.
        #[arg(long)]
        json: bool,
        #[arg(long)]
        contact_field: Option<String>,
    }

    fn parse(flags: &str) -> Result<Both, String> {
        Both::try_parse_from(std::iter::once("test").chain(flags.split_whitespace()))
            .map_err(|e| e.to_string())
    }

    #[test]
    fn no_flags_are_the_planners_defaults() {
        let both = parse("").unwrap();
        assert_eq!(both.scene.options(), SceneOptions::default());
        let (ours, theirs) = (both.search.options().unwrap(), PlanOptions::default());
        assert!((ours.orientation.cone_rad - theirs.orientation.cone_rad).abs() < 1e-12);
        assert_eq!(PlanOptions { orientation: theirs.orientation, ..ours }, theirs);
        assert_eq!(both.search.budget(), None);
    }

    #[test]
    fn flags_become_options() {
        let both = parse(
            "--scheme 60,60 --reaching 0,0,-2 --target-point -0.1,0.2,0,0.05 --keep-out 0,0,0.1,0.1,0.1,0.1,90 \
             --budget-ms 30 --volume occupancy --workspace -0.2,-0.2,0 --table-height 0.05",
        )
        .unwrap();
        let options = both.search.options().unwrap();
        assert_eq!(options.scheme, Scheme::QUICK);
        assert_eq!(options.reaching, Reaching::Direction(-Vector3::z_axis()));
        assert_eq!(
            options.target,
            Some(Target::Point { point: Point3::new(-0.1, 0.2, 0.0), radius_m: 0.05 })
        );
        assert_eq!(options.keep_out.len(), 1);
        assert_eq!(both.search.budget(), Some(Duration::from_millis(30)));
        assert_eq!(both.scene.options().volume, VolumeKind::Occupancy);
        assert!(matches!(both.scene.options().workspace, WorkspaceRequest::Placed { table_m: Some(_), .. }));
    }

    #[test]
    fn wrong_flags_say_what_is_expected() {
        assert!(parse("--scheme 40,200").unwrap_err().contains("the last of them with penetration"));
        assert!(parse("--target-point 1,2,3").unwrap_err().contains("found 3 numbers, expected 4 numbers"));
        assert!(parse("--reaching sideways").unwrap_err().contains("expected top-down, camera, free"));
        assert!(parse("--reaching 0,0,0").unwrap_err().contains("not zero"));
        assert!(parse("--t-fc 1.5").unwrap_err().contains("from 0 to 1"));
        assert!(parse("--trace").unwrap_err().contains("--json"));
        assert!(parse("--trace --json").unwrap().search.options().unwrap().trace);
        assert_eq!(parse("--estimator geometric").unwrap().scene.estimator().name(), Some("geometric"));
        let message = parse("--friction 0").unwrap().search.options().unwrap_err().to_string();
        assert!(message.starts_with("--friction: found 0, expected"), "{message}");
    }
}
