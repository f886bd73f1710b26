//! `graspd plan`: ranked grasps for one depth image, planned here or by a server.

use std::io::Write as _;
use std::path::{Path, PathBuf};

use anyhow::Context as _;
use clap::Args;
use graspd_hands::Hand;
use graspd_planner::frame::Frame;

use super::args::{SceneArgs, SearchArgs};
use crate::hand_source;
use crate::input::depth::RawDepth;
use crate::input::intrinsics::FrameFile;
use crate::input::{labels, npz};
use crate::local::{self, Observed, Settings};
use crate::outcome::Outcome;
use crate::output::{json, table};
use crate::remote::{self, Question};
use crate::view::{HandView, ViewScene, page, picture};

/// Plans grasps from a depth image. Ends with 0 also when there is no grasp (the answer says why), with 1 for
/// an input that cannot be planned from.
#[derive(Debug, Clone, Args)]
pub(crate) struct PlanArgs {
    /// Depth image: 16-bit grey PNG, or a NumPy array of integers or metres
    #[arg(required_unless_present = "contact_field")]
    depth: Option<PathBuf>,
    /// Intrinsics, depth scale and, where known, pose of the camera, as JSON
    #[arg(long, value_name = "JSON", required_unless_present = "contact_field")]
    intrinsics: Option<PathBuf>,
    /// A hand by its id (see `graspd hands list`) or by its folder; may be repeated
    #[arg(long = "hand", value_name = "ID", required = true)]
    hands: Vec<String>,
    /// Object labels of the pixels: 8-bit PNG of the size of the depth image
    #[arg(long, value_name = "PNG")]
    labels: Option<PathBuf>,
    /// Plan in a contact field that was made elsewhere (NumPy archive) instead of a depth image
    #[arg(long, value_name = "NPZ", conflicts_with_all = ["depth", "intrinsics", "labels", "server", "estimator", "model"])]
    contact_field: Option<PathBuf>,
    /// Ask this server, for example http://127.0.0.1:50051, instead of planning in this process. Left out, the
    /// variable GRASPD_SERVER of the environment names it; a contact field, and a network of one's own, are planned with in
    /// here in any case
    #[arg(long, value_name = "URL", conflicts_with = "model")]
    server: Option<String>,
    /// Print JSON
    #[arg(long)]
    json: bool,
    /// Write a page that shows the scene and every grasp in a browser
    #[arg(long, value_name = "HTML")]
    page: Option<PathBuf>,
    /// Write a picture of the best grasp of every hand
    #[arg(long, value_name = "PNG")]
    picture: Option<PathBuf>,
    #[command(flatten)]
    scene: SceneArgs,
    #[command(flatten)]
    search: SearchArgs,
}

impl PlanArgs {
    /// The server to ask: that of the flag, or that of the environment for what a server can be asked.
    fn server(&self, environment: Option<String>) -> Option<String> {
        let here = self.contact_field.is_some() || self.scene.estimator().has_models();
        let environment = environment.filter(|url| !url.is_empty() && !here);
        self.server.clone().or(environment)
    }
}

/// Runs the command.
///
/// # Errors
/// For files that cannot be read, unknown hands, flags out of range, and a server that refuses.
pub(crate) fn run(args: &PlanArgs) -> anyhow::Result<()> {
    let scene_options = args.scene.options();
    let options = args.search.options()?;
    anyhow::ensure!(
        args.search.wants_labels().is_none() || args.labels.is_some(),
        "--target-label: found no label image, expected --labels PNG"
    );
    let input = Input::open(args)?;
    let wants_view = args.page.is_some() || args.picture.is_some();
    let settings = Settings {
        scene: &scene_options,
        search: &options,
        estimator: args.scene.estimator(),
        budget: args.search.budget(),
    };
    let server = args.server(std::env::var("GRASPD_SERVER").ok());
    let (hands, outcomes, scene) = if let (Some(url), Input::Files(files)) = (&server, &input) {
        let outcomes = remote::plan(url, &Question { files, settings, hands: &args.hands })?;
        let hands = args.hands.iter().filter_map(|name| hand_source::resolve(name).ok()).collect();
        (hands, outcomes, None)
    } else {
        let hands: Vec<Hand> =
            args.hands.iter().map(|n| hand_source::resolve(n)).collect::<anyhow::Result<_>>()?;
        let (scene, outcomes) = local::plan(&input.observed(), &hands, &settings)?;
        (hands, outcomes, scene)
    };
    let mut out = std::io::stdout().lock();
    if args.json {
        writeln!(out, "{:#}", json::plans(&outcomes))?;
    } else {
        write!(out, "{}", table::grasps(&outcomes))?;
    }
    if wants_view {
        // Drawings need the scene, which a server's answer does not carry.
        let scene =
            scene.map_or_else(|| input.observed().scene(&scene_options, args.scene.estimator()), Ok)?;
        let view = ViewScene::new(&scene, input.observed().frame());
        let shown = views(&hands, &outcomes);
        if let Some(path) = &args.page {
            let hands = if shown.len() == 1 { "1 hand".to_owned() } else { format!("{} hands", shown.len()) };
            let about = format!("{hands}, planned by graspd {}", env!("CARGO_PKG_VERSION"));
            write_file(
                path,
                page::render(&format!("Grasps from {}", input.name()), &about, &view, &shown).as_bytes(),
            )?;
        }
        if let Some(path) = &args.picture {
            write_file(path, &picture::render(&view, &shown)?)?;
        }
    }
    Ok(())
}

/// Hands beside their answers; answers for hands that are not known here are left out.
pub(crate) fn views<'a>(hands: &'a [Hand], outcomes: &'a [Outcome]) -> Vec<HandView<'a>> {
    outcomes
        .iter()
        .filter_map(|outcome| {
            let hand = hands.iter().find(|h| h.id == outcome.hand);
            if hand.is_none() {
                tracing::warn!(hand = outcome.hand, "not drawn: its shapes are not known here");
            }
            Some(HandView { hand: hand?, outcome })
        })
        .collect()
}

/// Writes a whole file.
///
/// # Errors
/// With the file's name.
pub(crate) fn write_file(path: &Path, bytes: &[u8]) -> anyhow::Result<()> {
    std::fs::write(path, bytes).with_context(|| format!("{}: cannot be written", path.display()))
}

/// The files of a depth frame, read and checked.
#[derive(Debug, Clone)]
pub(crate) struct FrameFiles {
    /// The image.
    pub(crate) depth: RawDepth,
    /// The lens.
    pub(crate) file: FrameFile,
    /// The labels.
    pub(crate) labels: Option<Vec<u8>>,
    /// All of it, as the planner reads it.
    pub(crate) frame: Frame,
}

impl FrameFiles {
    /// Puts the parts together.
    ///
    /// # Errors
    /// If they do not fit each other.
    pub(crate) fn new(depth: RawDepth, file: FrameFile, labels: Option<Vec<u8>>) -> anyhow::Result<Self> {
        let frame = file.frame(&depth, labels.clone())?;
        Ok(Self { depth, file, labels, frame })
    }
}

/// What is planned from.
enum Input {
    Files(Box<FrameFiles>),
    Field { observed: Observed, name: String },
}

impl Input {
    fn open(args: &PlanArgs) -> anyhow::Result<Self> {
        if let Some(path) = &args.contact_field {
            let observed = Observed::Field(Box::new(npz::open(path)?));
            return Ok(Self::Field { observed, name: path.display().to_string() });
        }
        let (Some(depth), Some(intrinsics)) = (&args.depth, &args.intrinsics) else {
            anyhow::bail!("a depth image and --intrinsics are needed");
        };
        let depth = RawDepth::open(depth)?;
        let file = FrameFile::open(intrinsics)?;
        let labels = args.labels.as_ref().map(|p| labels::open(p, depth.width, depth.height)).transpose()?;
        Ok(Self::Files(Box::new(FrameFiles::new(depth, file, labels)?)))
    }

    fn observed(&self) -> Observed {
        match self {
            Self::Files(files) => Observed::Frame(Box::new(files.frame.clone())),
            Self::Field { observed, .. } => observed.clone(),
        }
    }

    /// The file's name without its folder, for titles.
    fn name(&self) -> String {
        let path = match self {
            Self::Files(files) => &files.depth.file,
            Self::Field { name, .. } => name,
        };
        Path::new(path).file_name().map_or_else(|| path.clone(), |name| name.to_string_lossy().into_owned())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;

    #[derive(Debug, Parser)]
    struct Only {
        #[command(flatten)]
        plan: PlanArgs,
    }

    fn parse(flags: &str) -> Result<PlanArgs, String> {
        let words = std::iter::once("plan").chain(flags.split(' '));
        Only::try_parse_from(words).map(|only| only.plan).map_err(|e| e.to_string())
    }

    #[test]
    fn the_environment_names_a_server_where_one_can_be_asked() {
        let environment = || Some("http://host:1".to_owned());
        let frame = parse("d.png --intrinsics i.json --hand leap").unwrap();
        assert_eq!(frame.server(environment()), environment());
        assert_eq!(frame.server(Some(String::new())), None);
        let named = parse("d.png --intrinsics i.json --hand leap --server http://other:2").unwrap();
        assert_eq!(named.server(environment()), Some("http://other:2".to_owned()));
        let field = parse("--contact-field f.npz --hand leap").unwrap();
        assert_eq!(field.server(environment()), None);
        let both = parse("--contact-field f.npz --hand leap --server http://other:2").unwrap_err();
        assert!(both.contains("--server"), "{both}");
        // A server has networks of its own: one's own must not be left aside unsaid.
        let own = parse("d.png --intrinsics i.json --hand leap --model mine.onnx").unwrap();
        assert_eq!(own.server(environment()), None);
        let both = parse("d.png --intrinsics i.json --hand leap --model mine.onnx --server http://other:2");
        assert!(both.unwrap_err().contains("--model"));
    }
}
