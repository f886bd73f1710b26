//! Planning by a server: through the typed client, the same answers as planning here.

pub(crate) mod from_wire;
pub(crate) mod to_wire;

use std::time::Duration;

use anyhow::{Context as _, bail};
use graspd_client::{Client, ClientConfig, ClientTls, HandTask, MultiHandEvent, PlanMultiHandRequest, Token};
use graspd_proto::v1::hand_task_result;

use crate::commands::plan::FrameFiles;
use crate::hand_source;
use crate::local::Settings;
use crate::outcome::Outcome;

/// Hands in one request; the protocol's limit.
const HANDS_A_REQUEST: usize = 16;
/// How long a call may take.
const CALL_TIMEOUT: Duration = Duration::from_secs(120);

/// What is asked of a server.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Question<'a> {
    /// The frame.
    pub(crate) files: &'a FrameFiles,
    /// How it is read and how grasps are searched.
    pub(crate) settings: Settings<'a>,
    /// Ids of the hands.
    pub(crate) hands: &'a [String],
}

/// The answers, and how long the server took for all of them.
#[derive(Debug, Clone)]
pub(crate) struct Answers {
    /// One for each hand, in the order of the question.
    pub(crate) outcomes: Vec<Outcome>,
    /// From the arrival of the requests to their last messages.
    pub(crate) total: Duration,
}

/// Connects to a server.
///
/// # Errors
/// If nobody answers there.
pub(crate) async fn connect(url: &str) -> anyhow::Result<Client> {
    let url = if url.contains("://") { url.to_owned() } else { format!("http://{url}") };
    Ok(Client::connect(ClientConfig { call_timeout: CALL_TIMEOUT, ..config(url)? }).await?)
}

/// How a server is reached: the token in `GRASPD_TOKEN`, and for `https` the roots in the file that `GRASPD_ROOTS`
/// names.
///
/// # Errors
/// If that file is missing or cannot be read.
pub(crate) fn config(url: String) -> anyhow::Result<ClientConfig> {
    let variable = |name| std::env::var(name).ok().filter(|value| !value.is_empty());
    let tls = if url.starts_with("https://") {
        let path =
            variable("GRASPD_ROOTS").context("GRASPD_ROOTS: found nothing, expected a PEM file of roots")?;
        let roots_pem = std::fs::read_to_string(&path).with_context(|| format!("GRASPD_ROOTS: {path}"))?;
        Some(ClientTls { roots_pem, identity_pem: None, server_name: None })
    } else {
        None
    };
    Ok(ClientConfig { tls, token: variable("GRASPD_TOKEN").map(Token::new), ..ClientConfig::new(url) })
}

/// Asks a server, and waits for all answers.
///
/// # Errors
/// If nobody answers, a hand is unknown there, or the server refuses.
pub(crate) fn plan(url: &str, question: &Question<'_>) -> anyhow::Result<Vec<Outcome>> {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    runtime.block_on(async {
        let client = connect(url).await?;
        Ok(ask(&client, question, &mut |_| ()).await?.outcomes)
    })
}

/// Asks a server that is connected; `on_answer` sees each answer as it comes.
///
/// # Errors
/// As [`plan`].
pub(crate) async fn ask(
    client: &Client,
    question: &Question<'_>,
    on_answer: &mut dyn FnMut(&Outcome),
) -> anyhow::Result<Answers> {
    let known = client.list_hands().await?;
    let known: Vec<&str> = known.iter().map(|h| h.name.trim_start_matches("hands/")).collect();
    for id in question.hands {
        if !known.contains(&id.as_str()) {
            bail!("hand {id:?}: {}", hand_source::unknown(id, &known));
        }
    }
    let mut answers = Answers { outcomes: Vec::new(), total: Duration::ZERO };
    for hands in question.hands.chunks(HANDS_A_REQUEST) {
        let settings = &question.settings;
        let options = to_wire::plan_options(settings.search, settings.budget)?;
        let tasks = hands.iter().enumerate().map(|(i, id)| HandTask {
            task_id: i.to_string(),
            hand: format!("hands/{id}"),
            options: Some(options.clone()),
        });
        let request = PlanMultiHandRequest {
            frames: vec![to_wire::frame(question.files)],
            scene_options: Some(to_wire::scene_options(settings.scene, settings.estimator.name())),
            tasks: tasks.collect(),
            ..PlanMultiHandRequest::default()
        };
        let mut slots: Vec<Option<Outcome>> = vec![None; hands.len()];
        let mut stream = client.plan_multi_hand(&request).await?;
        while let Some(event) = stream.next().await? {
            match event {
                MultiHandEvent::Result(result) => {
                    let index: usize =
                        result.task_id.parse().context("the server answered an unknown task")?;
                    let id = hands.get(index).context("the server answered an unknown task")?;
                    let outcome = match result.outcome.context("the server answered nothing")? {
                        hand_task_result::Outcome::Response(response) => from_wire::outcome(id, &response)?,
                        hand_task_result::Outcome::Error(e) => {
                            bail!("hand {id:?}: {} ({})", e.message, e.reason)
                        }
                    };
                    on_answer(&outcome);
                    slots[index] = Some(outcome);
                }
                MultiHandEvent::Summary(summary) => {
                    answers.total +=
                        summary.total_duration.and_then(|d| Duration::try_from(d).ok()).unwrap_or_default();
                }
            }
        }
        for (slot, id) in slots.into_iter().zip(hands) {
            answers.outcomes.push(slot.with_context(|| format!("hand {id:?}: the server gave no answer"))?);
        }
    }
    Ok(answers)
}
