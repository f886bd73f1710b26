//! What is wrong with an arm's link, and what to do about it: nothing is moved or changed.

use std::time::Duration;

use graspd_adapters_core::FaultKind;
use graspd_adapters_core::check::Finding;
use tokio::net::TcpStream;

use crate::config::UrConfig;
use crate::dashboard::{Dashboard, DashboardError};
use crate::rtde::{Package, RtdeError, RtdeLink};
use crate::script::{BEAT_FIELDS, COMMAND_FIELDS, STREAM_FIELDS};
use crate::state::{RobotMode, RobotState};

/// Looks at everything that motion needs, in the order in which a person would fix it. Ends within a few times the
/// configured `connect_timeout_s`.
pub async fn diagnose(config: &UrConfig) -> Vec<Finding> {
    let mut findings = Vec::new();
    if let Err(error) = config.check() {
        findings.push(Finding::of_settings(&error));
        return findings;
    }
    findings.push(Finding::good("settings", format!("{} at {}", config.model.name(), config.host)));
    dashboard(config, &mut findings).await;
    state(config, &mut findings).await;
    let limit = Duration::from_secs_f64(config.connect_timeout_s);
    let primary = TcpStream::connect((config.host.as_str(), config.ports.primary));
    findings.push(match tokio::time::timeout(limit, primary).await {
        Ok(Ok(_)) => Finding::good("primary interface", "takes connections"),
        Ok(Err(error)) => Finding::bad(
            "primary interface",
            error.to_string(),
            "enable it on the pendant: Settings > Security > Services > Primary Client Interface",
        ),
        Err(_) => Finding::bad(
            "primary interface",
            format!("no answer within {limit:?}"),
            "check cable and address",
        ),
    });
    findings.push(Finding::of_arming(config.armed));
    findings
}

async fn dashboard(config: &UrConfig, findings: &mut Vec<Finding>) {
    let limit = Duration::from_secs_f64(config.connect_timeout_s);
    let dashboard = Dashboard::new(config.host.clone(), config.ports.dashboard, limit);
    match dashboard.version().await {
        Ok(version) => findings.push(Finding::good("dashboard", version)),
        Err(error) => {
            let remedy = match error {
                DashboardError::Link(_) | DashboardError::Timeout { .. } => {
                    "check cable and address; enable it: Settings > Security > Services > Dashboard Server \
                     (PolyScope X has none)"
                }
                _ => "check that the address is that of the robot's controller",
            };
            findings.push(Finding::bad("dashboard", error.to_string(), remedy));
            return;
        }
    }
    findings.push(match dashboard.is_remote().await {
        Ok(Some(true)) => Finding::good("remote control", "yes"),
        Ok(None) => Finding::good("remote control", "this software does not tell"),
        Ok(Some(false)) => {
            Finding::bad("remote control", "no", "choose Remote Control at the top right of the pendant")
        }
        Err(error) => Finding::bad("remote control", error.to_string(), "ask again"),
    });
    if let Ok(Some(model)) = dashboard.robot_model().await {
        let ours = config.model.name().trim_end_matches('e');
        let theirs = model.trim_end_matches('e');
        findings.push(if ours == theirs {
            Finding::good("model", model)
        } else {
            let remedy = format!("set model in the arm's settings to that of {model}");
            Finding::bad("model", format!("{model}, settings say {}", config.model.name()), remedy)
        });
    }
}

async fn state(config: &UrConfig, findings: &mut Vec<Finding>) {
    let limit = Duration::from_secs_f64(config.connect_timeout_s);
    let asked = async {
        let mut link = RtdeLink::connect((config.host.as_str(), config.ports.rtde)).await?;
        let outputs = link.set_up_outputs(10.0, &RobotState::FIELDS[..16]).await?;
        // Registers are given back when the link ends.
        let mut taken = Ok(());
        for fields in [&BEAT_FIELDS[..], &COMMAND_FIELDS[..], &STREAM_FIELDS[..]] {
            if let Err(error) = link.set_up_inputs(fields).await {
                taken = Err(error);
                break;
            }
        }
        link.start().await?;
        loop {
            if let Package::Data { recipe, bytes } = link.next().await? {
                let state = RobotState::from_values(&outputs.decode(recipe, &bytes)?)?;
                return Ok::<_, RtdeError>((link.version(), state, taken));
            }
        }
    };
    let (version, state, taken) = match tokio::time::timeout(limit, asked).await {
        Ok(Ok(found)) => found,
        Ok(Err(error)) => {
            let remedy = "check cable and address; enable it: Settings > Security > Services > RTDE";
            findings.push(Finding::bad("RTDE", error.to_string(), remedy));
            return;
        }
        Err(_) => {
            findings.push(Finding::bad(
                "RTDE",
                format!("no answer within {limit:?}"),
                "check cable and address",
            ));
            return;
        }
    };
    let [major, minor, bugfix, _] = version;
    findings.push(Finding::good("RTDE", format!("protocol 2, controller {major}.{minor}.{bugfix}")));
    findings.push(match taken {
        Ok(()) => Finding::good("registers", "24 and up are free"),
        Err(error) => {
            Finding::bad("registers", error.to_string(), "end the other client, or switch the fieldbus off")
        }
    });
    findings.push(match state.safety.fault() {
        None => Finding::good("safety", format!("{:?}", state.safety)),
        Some(kind) => {
            let remedy = match kind {
                FaultKind::ProtectiveStop => "inspect the cause, then unlock it on the pendant",
                FaultKind::EmergencyStop => "release the emergency button, then switch power on",
                _ => "see the pendant's log and clear it there",
            };
            Finding::bad("safety", format!("{:?}", state.safety), remedy)
        }
    });
    findings.push(match state.robot_mode {
        RobotMode::Running => Finding::good("power and brakes", "on, released"),
        mode => {
            Finding::bad("power and brakes", format!("{mode:?}"), "switch power on and release the brakes")
        }
    });
    if state.speed_scaling < 0.01 {
        let remedy = "raise the speed slider on the pendant; from 0 it may cause a protective stop";
        findings.push(Finding::bad("speed slider", format!("{:.0} %", 100.0 * state.speed_scaling), remedy));
    }
}
