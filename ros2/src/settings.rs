//! Settings: options of the command line, over a TOML file, over defaults.

use std::path::{Path, PathBuf};
use std::time::Duration;

use clap::{ArgAction, Parser, ValueEnum};
use graspd_client::{ClientConfig, ClientTls, Token};
use serde::Deserialize;

use crate::bridge::{BridgeConfig, TopicNames};
use crate::depth::Lens;
use crate::node::{NodeConfig, Services};
use crate::pairing::PairingRules;

/// Grasps from depth images, for ROS 2: a bridge to a graspd server. No ROS installation is needed.
#[derive(Debug, Clone, Parser)]
#[command(name = "graspd-ros2", version)]
pub struct Options {
    /// A TOML file with any of these settings (long names with underscores); options here go before it
    #[arg(long, value_name = "FILE", env = "GRASPD_ROS2_CONFIG")]
    pub config: Option<PathBuf>,
    /// Lines of the log, on standard error
    #[arg(long, value_enum, default_value_t = LogFormat::Text, env = "GRASPD_LOG_FORMAT")]
    pub log_format: LogFormat,
    #[command(flatten)]
    settings: Settings,
}

/// How a line of the log looks.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum LogFormat {
    /// For people.
    Text,
    /// One JSON object a line.
    Json,
}

/// Everything that can be set; what is left out here comes from the file, then from the defaults.
#[derive(Debug, Clone, PartialEq, Default, clap::Args, Deserialize)]
#[serde(deny_unknown_fields, default)]
struct Settings {
    /// The server [default: http://127.0.0.1:50051]
    #[arg(long, value_name = "URL", env = "GRASPD_SERVER", help_heading = "Server")]
    server: Option<String>,
    /// PEM file of the roots that an https server's certificate must come from
    #[arg(long, value_name = "FILE", env = "GRASPD_ROOTS", help_heading = "Server")]
    roots: Option<PathBuf>,
    /// PEM file of this client's certificate, with --key
    #[arg(long, value_name = "FILE", help_heading = "Server")]
    certificate: Option<PathBuf>,
    /// PEM file of its key
    #[arg(long, value_name = "FILE", help_heading = "Server")]
    key: Option<PathBuf>,
    /// Name in the server's certificate, where it is not the address's
    #[arg(long, value_name = "NAME", help_heading = "Server")]
    server_name: Option<String>,
    /// File that holds the token, where the server asks for one; or the variable GRASPD_TOKEN holds it
    #[arg(long, value_name = "FILE", help_heading = "Server")]
    token_file: Option<PathBuf>,
    /// How long a plan may take, seconds [default: 10]
    #[arg(long, value_name = "SECONDS", help_heading = "Server")]
    timeout_s: Option<f64>,

    /// The hand to plan for; more than once for several, the first is the default [default: robotiq-2f85]
    #[arg(long = "hand", value_name = "HAND", action = ArgAction::Append, help_heading = "Plans")]
    hands: Vec<String>,
    /// Grasps of an answer where a goal says nothing, 1 to 1000 [default: 10]
    #[arg(long, value_name = "COUNT", help_heading = "Plans")]
    max_grasps: Option<u32>,
    /// Goals at the same time [default: 4]
    #[arg(long, value_name = "COUNT", help_heading = "Plans")]
    max_goals: Option<usize>,
    /// Grasps that are drawn as markers [default: 3]
    #[arg(long, value_name = "COUNT", help_heading = "Plans")]
    drawn_grasps: Option<usize>,
    /// Time from one posture of the joint trajectory to the next, seconds [default: 1]
    #[arg(long, value_name = "SECONDS", help_heading = "Plans")]
    step_s: Option<f64>,

    /// Depth images: sensor_msgs/Image, 16UC1 or 32FC1 [default: /camera/depth/image_rect_raw]
    #[arg(long, value_name = "TOPIC", help_heading = "Frames")]
    image: Option<String>,
    /// sensor_msgs/CameraInfo [default: camera_info beside the image]
    #[arg(long, value_name = "TOPIC", help_heading = "Frames")]
    camera_info: Option<String>,
    /// Label images: sensor_msgs/Image, 8UC1. A frame then needs one
    #[arg(long, value_name = "TOPIC", help_heading = "Frames")]
    labels: Option<String>,
    /// The image is rectified: the camera info's P counts, not K and D
    #[arg(long, help_heading = "Frames")]
    rectified: bool,
    /// How far the stamps of an image and its camera info may be apart, seconds [default: 0]
    #[arg(long, value_name = "SECONDS", help_heading = "Frames")]
    stamp_tolerance_s: Option<f64>,
    /// Any camera info will do, whatever its stamp: one that is sent once
    #[arg(long, help_heading = "Frames")]
    any_camera_info: bool,
    /// A frame that has come longer ago is not planned on, seconds; 0: however old [default: 5]
    #[arg(long, value_name = "SECONDS", help_heading = "Frames")]
    max_age_s: Option<f64>,
    /// Ask publishers to repeat lost images: for lossy networks; publishers must be reliable
    #[arg(long, help_heading = "Frames")]
    reliable_images: bool,

    /// The node's name [default: graspd]
    #[arg(long, value_name = "NAME", help_heading = "Node")]
    node_name: Option<String>,
    /// Its namespace [default: /]
    #[arg(long, value_name = "NAMESPACE", help_heading = "Node")]
    namespace: Option<String>,
    /// Points to grasp at: geometry_msgs/PointStamped, as RViz's tool "Publish Point" sends them; empty: none [default:
    /// /clicked_point]
    #[arg(long, value_name = "TOPIC", help_heading = "Node")]
    point: Option<String>,
    /// DDS domain, 0 to 232 [default: the variable ROS_DOMAIN_ID, or 0]
    #[arg(long, value_name = "ID", help_heading = "Node")]
    domain_id: Option<u16>,
    /// Addresses of this machine whose networks are used; more than once for several [default: all; this machine alone where
    /// ROS_AUTOMATIC_DISCOVERY_RANGE is LOCALHOST]
    #[arg(long = "interface", value_name = "ADDRESS", action = ArgAction::Append, help_heading = "Node")]
    interfaces: Vec<std::net::IpAddr>,
    /// How the other side's middleware puts services on DDS [default: cyclone where RMW_IMPLEMENTATION is
    /// rmw_cyclonedds_cpp, else fastrtps]
    #[arg(long, value_enum, help_heading = "Node")]
    services: Option<Services>,
}

/// A setting that cannot be.
#[derive(Debug, thiserror::Error)]
pub enum SettingsError {
    /// A file cannot be read.
    #[error("{path}: {problem}")]
    File {
        /// The file.
        path: String,
        /// Why not.
        problem: String,
    },
    /// A value is out of its range.
    #[error("{field}: found {found}, expected {expected}")]
    Value {
        /// The option.
        field: &'static str,
        /// Its value.
        found: String,
        /// What it should be.
        expected: &'static str,
    },
}

fn wrong<T>(field: &'static str, found: impl ToString, expected: &'static str) -> Result<T, SettingsError> {
    Err(SettingsError::Value { field, found: found.to_string(), expected })
}

fn read(path: &Path) -> Result<String, SettingsError> {
    std::fs::read_to_string(path)
        .map_err(|error| SettingsError::File { path: path.display().to_string(), problem: error.to_string() })
}

impl Settings {
    /// These, and the others' where there are none.
    fn or(self, other: Self) -> Self {
        Self {
            server: self.server.or(other.server),
            roots: self.roots.or(other.roots),
            certificate: self.certificate.or(other.certificate),
            key: self.key.or(other.key),
            server_name: self.server_name.or(other.server_name),
            token_file: self.token_file.or(other.token_file),
            timeout_s: self.timeout_s.or(other.timeout_s),
            hands: if self.hands.is_empty() { other.hands } else { self.hands },
            max_grasps: self.max_grasps.or(other.max_grasps),
            max_goals: self.max_goals.or(other.max_goals),
            drawn_grasps: self.drawn_grasps.or(other.drawn_grasps),
            step_s: self.step_s.or(other.step_s),
            image: self.image.or(other.image),
            camera_info: self.camera_info.or(other.camera_info),
            labels: self.labels.or(other.labels),
            rectified: self.rectified || other.rectified,
            stamp_tolerance_s: self.stamp_tolerance_s.or(other.stamp_tolerance_s),
            any_camera_info: self.any_camera_info || other.any_camera_info,
            max_age_s: self.max_age_s.or(other.max_age_s),
            reliable_images: self.reliable_images || other.reliable_images,
            node_name: self.node_name.or(other.node_name),
            namespace: self.namespace.or(other.namespace),
            point: self.point.or(other.point),
            domain_id: self.domain_id.or(other.domain_id),
            interfaces: if self.interfaces.is_empty() { other.interfaces } else { self.interfaces },
            services: self.services.or(other.services),
        }
    }
}

/// What the parts of the bridge are told.
#[derive(Debug, Clone, PartialEq)]
pub struct Parts {
    /// The connection.
    pub client: ClientConfig,
    /// The planning.
    pub bridge: BridgeConfig,
    /// The node.
    pub node: NodeConfig,
}

impl Options {
    /// Reads the file and checks everything. Of the environment, `variable` tells the token and the range of discovery.
    ///
    /// # Errors
    /// [`SettingsError`] for the first setting that cannot be.
    pub fn parts(self, variable: impl Fn(&str) -> Option<String>) -> Result<Parts, SettingsError> {
        let file = match &self.config {
            None => Settings::default(),
            Some(path) => toml::from_str(&read(path)?).map_err(|error| SettingsError::File {
                path: path.display().to_string(),
                problem: error.to_string(),
            })?,
        };
        let all = self.settings.or(file);
        let client = client(&all, &variable)?;
        let node = node(&all, &variable)?;
        let hands = if all.hands.is_empty() { vec!["robotiq-2f85".to_owned()] } else { all.hands };
        for hand in &hands {
            // Their services are named after them.
            let fits = hand.starts_with(|c: char| c.is_ascii_alphabetic())
                && hand.chars().all(|c| c.is_ascii_alphanumeric() || c == '-');
            if !fits {
                return wrong("hand", format!("{hand:?}"), "an id as `graspd hands list` shows it");
            }
        }
        let max_grasps = all.max_grasps.unwrap_or(10);
        if !(1..=1000).contains(&max_grasps) {
            return wrong("max_grasps", max_grasps, "1 to 1000");
        }
        let max_goals = all.max_goals.unwrap_or(4);
        if max_goals == 0 {
            return wrong("max_goals", 0, "at least 1");
        }
        let bridge = BridgeConfig {
            node: node.full_name(),
            server: client.endpoint.clone(),
            hands: hands.clone(),
            pairing: PairingRules {
                labels: node.labels.is_some(),
                tolerance: seconds("stamp_tolerance_s", all.stamp_tolerance_s, 0.0)?,
                any_info: all.any_camera_info,
            },
            lens: if all.rectified { Lens::Rectified } else { Lens::Raw },
            max_age: Some(seconds("max_age_s", all.max_age_s, 5.0)?).filter(|age| !age.is_zero()),
            max_grasps,
            drawn_grasps: all.drawn_grasps.unwrap_or(3),
            max_goals,
            step: seconds("step_s", all.step_s, 1.0)?,
            topics: TopicNames {
                image: node.image.clone(),
                info: node.info.clone(),
                labels: node.labels.clone(),
            },
        };
        Ok(Parts { client, bridge, node: NodeConfig { hands, ..node } })
    }
}

fn seconds(field: &'static str, value: Option<f64>, default: f64) -> Result<Duration, SettingsError> {
    let value = value.unwrap_or(default);
    Duration::try_from_secs_f64(value)
        .ok()
        .filter(|time| *time <= Duration::from_secs(3600))
        .map_or_else(|| wrong(field, value, "0 to 3600 seconds"), Ok)
}

fn client(all: &Settings, variable: &impl Fn(&str) -> Option<String>) -> Result<ClientConfig, SettingsError> {
    let server = all.server.clone().unwrap_or_else(|| "http://127.0.0.1:50051".to_owned());
    let server = if server.contains("://") { server } else { format!("http://{server}") };
    let tls = if server.starts_with("https://") {
        let Some(roots) = &all.roots else {
            return wrong("roots", "nothing", "a PEM file of roots for https");
        };
        let identity = match (&all.certificate, &all.key) {
            (Some(certificate), Some(key)) => Some((read(certificate)?, Token::new(read(key)?))),
            (None, None) => None,
            _ => return wrong("certificate, key", "one of them", "both or none"),
        };
        Some(ClientTls {
            roots_pem: read(roots)?,
            identity_pem: identity,
            server_name: all.server_name.clone(),
        })
    } else if server.starts_with("http://") {
        None
    } else {
        return wrong("server", format!("{server:?}"), "http://… or https://…");
    };
    let token = match &all.token_file {
        Some(path) => Some(read(path)?.trim().to_owned()),
        None => variable("GRASPD_TOKEN"),
    };
    let call_timeout = seconds("timeout_s", all.timeout_s, 10.0)?;
    if call_timeout.is_zero() {
        return wrong("timeout_s", 0, "more than 0");
    }
    let token = token.filter(|t| !t.is_empty()).map(Token::new);
    Ok(ClientConfig { call_timeout, tls, token, ..ClientConfig::new(server) })
}

fn node(all: &Settings, variable: &impl Fn(&str) -> Option<String>) -> Result<NodeConfig, SettingsError> {
    let image = all.image.clone().unwrap_or_else(|| "/camera/depth/image_rect_raw".to_owned());
    let info = all.camera_info.clone().unwrap_or_else(|| match image.rsplit_once('/') {
        Some((folder, _)) => format!("{folder}/camera_info"),
        None => "camera_info".to_owned(),
    });
    let domain_id = match (all.domain_id, variable("ROS_DOMAIN_ID").filter(|id| !id.is_empty())) {
        (Some(id), _) => id,
        (None, Some(id)) => match id.parse() {
            Ok(id) => id,
            Err(_) => return wrong("ROS_DOMAIN_ID", format!("{id:?}"), "0 to 232"),
        },
        (None, None) => 0,
    };
    if domain_id > 232 {
        return wrong("domain_id", domain_id, "0 to 232");
    }
    let alone = variable("ROS_AUTOMATIC_DISCOVERY_RANGE").is_some_and(|range| range == "LOCALHOST")
        || variable("ROS_LOCALHOST_ONLY").is_some_and(|only| only == "1");
    let interfaces = if all.interfaces.is_empty() && alone {
        vec![std::net::Ipv4Addr::LOCALHOST.into()]
    } else {
        all.interfaces.clone()
    };
    let mut namespace = all.namespace.clone().unwrap_or_default();
    if !namespace.starts_with('/') {
        namespace.insert(0, '/');
    }
    Ok(NodeConfig {
        name: all.node_name.clone().unwrap_or_else(|| "graspd".to_owned()),
        namespace,
        hands: Vec::new(),
        image,
        info,
        labels: all.labels.clone().filter(|topic| !topic.is_empty()),
        point: Some(all.point.clone().unwrap_or_else(|| "/clicked_point".to_owned()))
            .filter(|t| !t.is_empty()),
        reliable_images: all.reliable_images,
        domain_id,
        interfaces,
        services: all.services.unwrap_or(match variable("RMW_IMPLEMENTATION").as_deref() {
            Some("rmw_cyclonedds_cpp") => Services::Cyclone,
            _ => Services::Fastrtps,
        }),
    })
}

#[cfg(test)]
mod tests;
