//! `graspd demo`: everything once, over a real socket, from the frame that comes with graspd.

use std::io::{IsTerminal as _, Write as _};
use std::path::{Path, PathBuf};

use anyhow::Context as _;
use clap::Args;
use graspd_hands::{Hand, library};
use graspd_planner::options::{PlanOptions, SceneOptions};
use graspd_server::{Server, ServerConfig};
use indicatif::{ProgressBar, ProgressStyle};

use super::plan::{FrameFiles, views, write_file};
use crate::demo_scene;
use crate::estimators::EstimatorArgs;
use crate::local::{Observed, Settings};
use crate::outcome::Outcome;
use crate::output::table;
use crate::remote::{self, Answers, Question};
use crate::view::{ViewScene, page, picture};

/// Starts a server, plans grasps for every hand from the bundled depth frame over gRPC, and draws them.
#[derive(Debug, Clone, Args)]
pub(crate) struct DemoArgs {
    /// Folder for graspd-demo.png and graspd-demo.html
    #[arg(long, default_value = ".", value_name = "DIR")]
    out: PathBuf,
    /// Hands to plan for, by id; all of the library if left out
    #[arg(long = "hand", value_name = "ID")]
    hands: Vec<String>,
    /// Seed of the search
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Write the bundled frame anew into this folder instead
    #[arg(long, value_name = "DIR", hide = true)]
    regenerate: Option<PathBuf>,
}

/// Runs the demo.
///
/// # Errors
/// For an unknown hand, a folder that cannot be written, and a server that does not start.
pub(crate) fn run(args: &DemoArgs) -> anyhow::Result<()> {
    if let Some(folder) = &args.regenerate {
        return regenerate(folder);
    }
    std::fs::create_dir_all(&args.out)
        .with_context(|| format!("{}: cannot be created", args.out.display()))?;
    let (depth, file) = demo_scene::bundled()?;
    let files = FrameFiles::new(depth, file, None)?;
    let hands: Vec<String> = if args.hands.is_empty() {
        library::ids().iter().map(|&id| id.to_owned()).collect()
    } else {
        args.hands.clone()
    };
    // Twice the usual batch: on a frame with small objects the largest hands need the choice.
    let search = PlanOptions { seed: args.seed, batch: 96, ..PlanOptions::default() };
    let scene_options = SceneOptions::default();
    let estimator = EstimatorArgs::default();
    let question =
        Question { files: &files, settings: settings(&scene_options, &search, &estimator), hands: &hands };
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build()?;
    let answers = runtime.block_on(over_the_wire(&question))?;

    let mut out = std::io::stdout().lock();
    write!(out, "{}", table::hands(&answers.outcomes))?;
    let grasps: usize = answers.outcomes.iter().map(|o| o.grasps.len()).sum();
    writeln!(
        out,
        "{grasps} grasps for {} hands from one depth frame in {:.2} s",
        answers.outcomes.len(),
        answers.total.as_secs_f64()
    )?;
    // Whoever watches reads the table while the picture is drawn.
    out.flush()?;
    let progress = Progress::new("drawing the picture and the page", 0);
    let drawn = draw(&args.out, &files, &answers.outcomes);
    progress.end();
    let (png, html) = drawn?;
    writeln!(out, "picture: {}\npage:    {} (open it in a browser)", png.display(), html.display())?;
    Ok(())
}

fn settings<'a>(
    scene: &'a SceneOptions,
    search: &'a PlanOptions,
    estimator: &'a EstimatorArgs,
) -> Settings<'a> {
    Settings { scene, search, estimator, budget: None }
}

/// Starts a server on a free port of this machine and asks it.
async fn over_the_wire(question: &Question<'_>) -> anyhow::Result<Answers> {
    let listen = ([127, 0, 0, 1], 0).into();
    let server = Server::bind(ServerConfig { listen, ..ServerConfig::default() }).await?;
    let url = format!("http://{}", server.local_addr());
    let (stop, stopped) = tokio::sync::oneshot::channel::<()>();
    let serving = tokio::spawn(server.serve_until(async {
        stopped.await.ok();
    }));
    let progress = Progress::new(&format!("server at {url}"), question.hands.len());
    let client = remote::connect(&url).await?;
    let answers = remote::ask(&client, question, &mut |outcome| progress.answer(outcome)).await;
    progress.end();
    // The server ends when the other end of the channel is used or dropped; that it has ended already is fine.
    stop.send(()).ok();
    drop(client);
    serving.await??;
    answers
}

/// Draws picture and page; their paths.
fn draw(folder: &Path, files: &FrameFiles, outcomes: &[Outcome]) -> anyhow::Result<(PathBuf, PathBuf)> {
    // The answer carries grasps, not the contact field: the same scene is read here once more.
    let observed = Observed::Frame(Box::new(files.frame.clone()));
    let scene = observed.scene(&SceneOptions::default(), &EstimatorArgs::default())?;
    let view = ViewScene::new(&scene, Some(&files.frame));
    let hands: Vec<Hand> = outcomes.iter().filter_map(|o| library::hand(&o.hand)).cloned().collect();
    let shown = views(&hands, outcomes);
    let (png, html) = (folder.join("graspd-demo.png"), folder.join("graspd-demo.html"));
    write_file(&png, &picture::render(&view, &shown)?)?;
    let about = format!(
        "{} hands, one depth frame of a simulated table; planned by graspd {}",
        shown.len(),
        env!("CARGO_PKG_VERSION")
    );
    write_file(&html, page::render("graspd demo", &about, &view, &shown).as_bytes())?;
    Ok((png, html))
}

fn regenerate(folder: &Path) -> anyhow::Result<()> {
    let frame = demo_scene::clutter(demo_scene::SEED);
    write_file(&folder.join("demo_depth.png"), &frame.to_png()?)?;
    write_file(&folder.join("demo_frame.json"), frame.to_json().as_bytes())
}

/// A bar on a terminal, plain lines elsewhere; on standard error, which holds no results.
struct Progress {
    bar: Option<ProgressBar>,
}

impl Progress {
    /// Begins with a message; a bar of `hands` steps, or a spinner alone where there are none.
    fn new(message: &str, hands: usize) -> Self {
        if !std::io::stderr().is_terminal() {
            writeln!(std::io::stderr(), "{message}").ok();
            return Self { bar: None };
        }
        let bar = ProgressBar::new(hands as u64);
        let template =
            if hands > 0 { "{spinner} {bar:30} {pos}/{len} {msg}" } else { "{spinner} {elapsed} {msg}" };
        if let Ok(style) = ProgressStyle::with_template(template) {
            bar.set_style(style);
        }
        bar.set_message(message.to_owned());
        bar.enable_steady_tick(std::time::Duration::from_millis(80));
        Self { bar: Some(bar) }
    }

    fn answer(&self, outcome: &Outcome) {
        let best =
            outcome.grasps.first().map_or_else(|| "no grasp".to_owned(), |g| format!("{:.3}", g.score));
        match &self.bar {
            Some(bar) => {
                bar.inc(1);
                bar.set_message(format!("{}: {best}", outcome.hand));
            }
            None => {
                writeln!(std::io::stderr(), "{}: {best}", outcome.hand).ok();
            }
        }
    }

    fn end(&self) {
        if let Some(bar) = &self.bar {
            bar.finish_and_clear();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use graspd_planner::options::Scheme;

    #[test]
    fn answers_over_the_wire_are_those_of_this_process() {
        let (depth, file) = demo_scene::bundled().unwrap();
        let files = FrameFiles::new(depth, file, None).unwrap();
        let search =
            PlanOptions { batch: 16, scheme: Scheme::QUICK, seed: 7, trace: true, ..PlanOptions::default() };
        let scene_options = SceneOptions::default();
        let hands = ["robotiq-2f85".to_owned(), "leap".to_owned()];
        let estimator = EstimatorArgs::default();
        let question = Question {
            files: &files,
            settings: settings(&scene_options, &search, &estimator),
            hands: &hands,
        };
        let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build().unwrap();
        let answers = runtime.block_on(over_the_wire(&question)).unwrap();
        let observed = Observed::Frame(Box::new(files.frame.clone()));
        let loaded: Vec<Hand> = hands.iter().map(|id| library::hand(id).unwrap().clone()).collect();
        let (_, local) = crate::local::plan(&observed, &loaded, &question.settings).unwrap();
        assert_eq!(answers.outcomes.len(), hands.len());
        for (id, (ours, theirs)) in hands.iter().zip(local.iter().zip(&answers.outcomes)) {
            assert_eq!(ours.origin.hand_revision, theirs.origin.hand_revision);
            assert_eq!(ours.origin.estimator, theirs.origin.estimator);
            assert_eq!((ours.origin.seed, theirs.origin.seed), (7, 7));
            let place = |o: &Outcome| o.origin.workspace.map(|w| (w.grid, w.table_m));
            assert!(place(ours).is_some() && place(ours) == place(theirs));
            assert_eq!(ours.trace.len(), 60, "{id}");
            assert_eq!(ours.trace, theirs.trace, "{id}");
            assert!(theirs.total > std::time::Duration::ZERO);
            assert_eq!(ours.rejected, theirs.rejected, "{id}");
            assert_eq!(ours.no_grasp.is_some(), theirs.no_grasp.is_some());
            let scores = |o: &Outcome| o.grasps.iter().map(|g| g.score).collect::<Vec<f64>>();
            assert_eq!(scores(ours), scores(theirs), "{id}");
            for (a, b) in ours.grasps.iter().zip(&theirs.grasps) {
                assert!(
                    (a.world_from_hand.translation.vector - b.world_from_hand.translation.vector).norm()
                        < 1e-9
                );
                assert_eq!(a.wrist_link, b.wrist_link);
                let off = a.camera_from_pregrasp.inverse() * b.camera_from_pregrasp;
                assert!(off.translation.vector.norm() < 1e-9);
                assert_eq!(
                    a.contacts.iter().map(|c| &c.link).collect::<Vec<_>>(),
                    b.contacts.iter().map(|c| &c.link).collect::<Vec<_>>()
                );
                assert_eq!(a.joints.names, b.joints.names);
                assert_eq!(a.actuators.values, b.actuators.values);
                assert_eq!(a.contacts.len(), b.contacts.len());
            }
        }
    }

    #[test]
    fn an_unknown_hand_is_refused_with_a_suggestion() {
        let (depth, file) = demo_scene::bundled().unwrap();
        let files = FrameFiles::new(depth, file, None).unwrap();
        let (search, scene_options) = (PlanOptions::default(), SceneOptions::default());
        let hands = ["robotiq_3f".to_owned()];
        let estimator = EstimatorArgs::default();
        let question = Question {
            files: &files,
            settings: settings(&scene_options, &search, &estimator),
            hands: &hands,
        };
        let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build().unwrap();
        let message = runtime.block_on(over_the_wire(&question)).unwrap_err().to_string();
        assert!(message.contains("did you mean \"robotiq-3f\"?"), "{message}");
    }
}
