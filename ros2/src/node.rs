//! The ROS 2 node: topics and services on DDS. What comes is handed to the bridge, what the bridge says is published.

use std::net::IpAddr;
use std::pin::Pin;

use futures_util::future;
use futures_util::stream::{self, FuturesUnordered, Stream, StreamExt as _};
use ros2_client::dds::rustdds::DomainParticipantBuilder;
use ros2_client::qos::{Durability, History, WhenFull};
use ros2_client::{
    Context, MessageTypeName, Node, NodeName, NodeOptions, Publisher, QosProfile, RmwRequestId, Server,
    ServiceMapping, ServiceTypeName, Subscription,
};
use tokio::sync::{mpsc, oneshot};

use crate::bridge::{Incoming, Outgoing};
use crate::messages::{
    CameraInfo, DiagnosticArray, Image, JointState, JointTrajectory, MarkerArray, PointStamped, PoseArray,
    PoseStamped, Text, TriggerRequest, TriggerResponse, Typed,
};
use crate::names::{self, NameError};

/// Goals, cancellations and points that wait for the bridge.
const GOALS_KEPT: usize = 10;
/// How long the last messages may take to their subscribers when the bridge ends.
const LAST_WORDS: std::time::Duration = std::time::Duration::from_millis(300);

/// How the node is named and what it listens to.
#[derive(Debug, Clone, PartialEq)]
pub struct NodeConfig {
    /// Its name.
    pub name: String,
    /// Its namespace, `/` for none.
    pub namespace: String,
    /// Hands by id; each has a service of its own.
    pub hands: Vec<String>,
    /// Depth images.
    pub image: String,
    /// Camera infos.
    pub info: String,
    /// Label images.
    pub labels: Option<String>,
    /// Points to grasp at.
    pub point: Option<String>,
    /// Lost images are repeated.
    pub reliable_images: bool,
    /// DDS domain.
    pub domain_id: u16,
    /// Networks by this machine's addresses; empty: all.
    pub interfaces: Vec<IpAddr>,
    /// How services are put on DDS.
    pub services: Services,
}

/// How the other side's middleware puts services on DDS.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, clap::ValueEnum, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Services {
    /// As Fast DDS and Connext do.
    #[default]
    Fastrtps,
    /// As Cyclone DDS does.
    Cyclone,
}

impl NodeConfig {
    /// The node's full name.
    pub fn full_name(&self) -> String {
        format!("{}/{}", self.namespace.trim_end_matches('/'), self.name)
    }
}

/// Why there is no node.
#[derive(Debug, thiserror::Error)]
pub enum NodeError {
    /// A topic has no name that ROS has.
    #[error(transparent)]
    Name(#[from] NameError),
    /// The node itself has none.
    #[error("the node's name {found:?}: {problem}")]
    NodeName {
        /// Namespace and name.
        found: String,
        /// What is wrong with it.
        problem: String,
    },
    /// DDS does not work.
    #[error("DDS: {0}")]
    Dds(String),
}

fn dds(error: impl std::fmt::Display) -> NodeError {
    NodeError::Dds(error.to_string())
}

/// Images: the newest alone counts, and what is lost is lost.
fn sensor_data(reliable: bool) -> QosProfile {
    let newest = QosProfile::subscription_default();
    if reliable { newest.reliability_reliable(WhenFull::DEFAULT) } else { newest }
}

/// Goals and feedback: none may be lost.
fn events() -> QosProfile {
    QosProfile::publisher_default().history(History::KeepLast { depth: GOALS_KEPT })
}

/// Results: whoever subscribes later gets the last one.
fn latched() -> QosProfile {
    QosProfile::publisher_default().durability(Durability::TransientLocal)
}

/// The node.
pub struct RosNode {
    node: Node,
    images: Subscription<Image>,
    infos: Subscription<CameraInfo>,
    labels: Option<Subscription<Image>>,
    goals: Subscription<Text>,
    cancels: Subscription<Text>,
    points: Option<Subscription<PointStamped>>,
    /// Services with their hands; the first is the default one's.
    services: Vec<(Option<String>, Server<TriggerRequest, TriggerResponse>)>,
    out: Publishers,
}

impl std::fmt::Debug for RosNode {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_tuple("RosNode").field(&self.node.fully_qualified_name()).finish()
    }
}

struct Publishers {
    grasps: Publisher<PoseArray>,
    pregrasps: Publisher<PoseArray>,
    best_grasp: Publisher<PoseStamped>,
    joint_state: Publisher<JointState>,
    trajectory: Publisher<JointTrajectory>,
    markers: Publisher<MarkerArray>,
    feedback: Publisher<Text>,
    result: Publisher<Text>,
    status: Publisher<Text>,
    diagnostics: Publisher<DiagnosticArray>,
}

/// Makes topics of a node by their names.
struct Maker<'a> {
    node: Node,
    config: &'a NodeConfig,
}

impl Maker<'_> {
    fn topic<M: Typed>(
        &self,
        name: &str,
        qos: &QosProfile,
    ) -> Result<ros2_client::dds::rustdds::Topic, NodeError> {
        let name = names::resolve(name, &self.config.namespace, &self.config.name)?;
        self.node.create_topic(&name, MessageTypeName::new(M::PACKAGE, M::NAME), qos).map_err(dds)
    }

    fn subscribe<M: Typed>(&mut self, name: &str, qos: QosProfile) -> Result<Subscription<M>, NodeError> {
        let topic = self.topic::<M>(name, &qos)?;
        self.node.create_subscription(&topic, Some(qos)).map_err(dds)
    }

    fn publish<M: Typed>(&mut self, name: &str, qos: QosProfile) -> Result<Publisher<M>, NodeError> {
        let topic = self.topic::<M>(name, &qos)?;
        self.node.create_publisher(&topic, Some(qos)).map_err(dds)
    }

    fn serve(&mut self, name: &str) -> Result<Server<TriggerRequest, TriggerResponse>, NodeError> {
        let name = names::resolve(name, &self.config.namespace, &self.config.name)?;
        let mapping = match self.config.services {
            Services::Fastrtps => ServiceMapping::Enhanced,
            Services::Cyclone => ServiceMapping::Cyclone,
        };
        let kind = ServiceTypeName::new("std_srvs", "Trigger");
        self.node.create_server(mapping, &name, &kind, events(), events()).map_err(dds)
    }
}

impl RosNode {
    /// Joins the domain. Within a tokio runtime: discovery goes on beside it.
    ///
    /// # Errors
    /// [`NodeError`].
    pub fn new(config: &NodeConfig) -> Result<Self, NodeError> {
        let name = NodeName::new(&config.namespace, &config.name)
            .map_err(|error| NodeError::NodeName { found: config.full_name(), problem: error.to_string() })?;
        let mut participant = DomainParticipantBuilder::new(config.domain_id);
        if !config.interfaces.is_empty() {
            participant = participant.with_only_networks(config.interfaces.iter().copied());
        }
        let context = Context::from_domain_participant(participant.build().map_err(dds)?).map_err(dds)?;
        // Settings are the command line's; what there is to log goes to standard error and to `~/status`.
        let options = NodeOptions::new().enable_rosout(false).start_parameter_services(false);
        let mut node = context.new_node(name, options).map_err(dds)?;
        let spinner = node.spinner().map_err(dds)?;
        tokio::spawn(async move {
            if let Err(error) = spinner.spin().await {
                tracing::error!(%error, "discovery ended");
            }
        });
        let mut make = Maker { node, config };
        let images = make.subscribe(&config.image, sensor_data(config.reliable_images))?;
        // Infos are small, and two of them may come before their images do.
        let infos = sensor_data(false).history(History::KeepLast { depth: GOALS_KEPT });
        let infos = make.subscribe(&config.info, infos)?;
        let labels = match &config.labels {
            Some(topic) => Some(make.subscribe(topic, sensor_data(config.reliable_images))?),
            None => None,
        };
        let points = match &config.point {
            Some(topic) => Some(make.subscribe(topic, events())?),
            None => None,
        };
        let mut services = vec![(None, make.serve("~/plan_grasps")?)];
        for hand in &config.hands {
            let server = make.serve(&format!("~/plan_grasps/{}", hand.replace('-', "_")))?;
            services.push((Some(hand.clone()), server));
        }
        let out = Publishers {
            grasps: make.publish("~/grasps", latched())?,
            pregrasps: make.publish("~/pregrasps", latched())?,
            best_grasp: make.publish("~/best_grasp", latched())?,
            joint_state: make.publish("~/joint_state", latched())?,
            trajectory: make.publish("~/joint_trajectory", latched())?,
            markers: make.publish("~/markers", latched())?,
            feedback: make.publish("~/feedback", events())?,
            result: make.publish("~/result", latched().history(History::KeepLast { depth: GOALS_KEPT }))?,
            status: make.publish("~/status", latched())?,
            diagnostics: make.publish("/diagnostics", events())?,
        };
        let (goals, cancels) = (make.subscribe("~/goal", events())?, make.subscribe("~/cancel", events())?);
        Ok(Self { node: make.node, images, infos, labels, goals, cancels, points, services, out })
    }

    /// Carries messages until the bridge has nothing more to say.
    pub async fn run(self, bridge: mpsc::Sender<Incoming>, mut said: mpsc::UnboundedReceiver<Outgoing>) {
        let mut inputs = stream::select_all(self.inputs());
        let mut answers = FuturesUnordered::new();
        loop {
            tokio::select! {
                Some(input) = inputs.next() => match input {
                    // A newer image comes soon: a bridge that is busy misses this one.
                    Input::Message(message @ (Incoming::Image(_) | Incoming::Labels(_))) => {
                        drop(bridge.try_send(message));
                    }
                    Input::Message(message) => drop(bridge.send(message).await),
                    Input::Call(service, request) => {
                        let (reply, answer) = oneshot::channel();
                        let hand = self.services.get(service).and_then(|(hand, _)| hand.clone());
                        drop(bridge.send(Incoming::Service { hand, reply }).await);
                        answers.push(async move { (service, request, answer.await) });
                    }
                },
                Some((service, request, answer)) = answers.next() => self.answer(service, request, answer).await,
                message = said.recv() => match message {
                    Some(message) => self.publish(message).await,
                    None => break,
                },
            }
        }
        while let Some((service, request, answer)) = answers.next().await {
            self.answer(service, request, answer).await;
        }
        // Dropping the node takes its messages with it.
        tokio::time::sleep(LAST_WORDS).await;
    }

    fn inputs(&self) -> Vec<Pin<Box<dyn Stream<Item = Input> + '_>>> {
        let mut all = vec![
            of(&self.images, Incoming::Image),
            of(&self.infos, |info| Incoming::Info(Box::new(info))),
            of(&self.goals, |text| Incoming::Goal(text.data)),
            of(&self.cancels, |text| Incoming::Cancel(text.data)),
        ];
        all.extend(self.labels.iter().map(|topic| of(topic, Incoming::Labels)));
        all.extend(self.points.iter().map(|topic| of(topic, Incoming::Point)));
        for (index, (_, server)) in self.services.iter().enumerate() {
            let calls = server.receive_request_stream().filter_map(move |call| async move {
                match call {
                    Ok((request, _)) => Some(Input::Call(index, request)),
                    Err(error) => {
                        tracing::warn!(%error, "a call that cannot be read");
                        None
                    }
                }
            });
            all.push(Box::pin(calls));
        }
        all
    }

    async fn answer(
        &self,
        service: usize,
        request: RmwRequestId,
        answer: Result<TriggerResponse, oneshot::error::RecvError>,
    ) {
        let Some((_, server)) = self.services.get(service) else { return };
        let answer = answer.unwrap_or_else(|_| TriggerResponse {
            success: false,
            message: r#"{"state":"canceled","reason":"STOPPING","message":"the bridge is ending"}"#
                .to_owned(),
        });
        if let Err(error) = server.async_send_response(request, answer).await {
            tracing::warn!(%error, "an answer cannot be sent");
        }
    }

    async fn publish(&self, message: Outgoing) {
        let out = &self.out;
        match message {
            Outgoing::Plan(plan) => {
                let (answer, markers) = *plan;
                send(&out.grasps, answer.grasps).await;
                send(&out.pregrasps, answer.pregrasps).await;
                if let Some(best) = answer.best {
                    send(&out.best_grasp, best.pose).await;
                    send(&out.joint_state, best.joints).await;
                    send(&out.trajectory, best.trajectory).await;
                }
                send(&out.markers, markers).await;
            }
            Outgoing::Feedback(data) => send(&out.feedback, Text { data }).await,
            Outgoing::Result(data) => send(&out.result, Text { data }).await,
            Outgoing::Status(data) => send(&out.status, Text { data }).await,
            Outgoing::Diagnostics(message) => send(&out.diagnostics, message).await,
        }
    }
}

/// What comes from DDS.
enum Input {
    Message(Incoming),
    Call(usize, RmwRequestId),
}

/// A topic's messages; one that cannot be read is left out, and logged unless many are.
fn of<'a, M: Typed>(
    topic: &'a Subscription<M>,
    message: impl Fn(M) -> Incoming + 'a,
) -> Pin<Box<dyn Stream<Item = Input> + 'a>> {
    let mut unreadable = 0u64;
    Box::pin(topic.async_stream().filter_map(move |read| {
        future::ready(match read {
            Ok((read, _)) => Some(Input::Message(message(read))),
            Err(error) => {
                unreadable += 1;
                // Whoever sends such things sends many.
                if unreadable.is_power_of_two() {
                    tracing::warn!(%error, count = unreadable, "a {} that cannot be read", M::NAME);
                }
                None
            }
        })
    }))
}

/// A subscriber that does not keep up must not hold the others up for long: a message is given up after 100 ms then.
async fn send<M: Typed>(topic: &Publisher<M>, message: M) {
    if let Err(error) = topic.async_publish(message).await {
        tracing::warn!(%error, "a {} that cannot be sent", M::NAME);
    }
}
