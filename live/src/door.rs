//! Who may come in: a viewer on this machine, and no page of a stranger's that its user has open.
//!
//! - `Host` is a loopback address or `localhost`: any other name would be one that somebody has pointed at this machine
//!   (DNS rebinding).
//! - `Origin`, which browsers send and pages cannot change, is a page of this machine, a file (desktop programs), or
//!   one that was allowed by name. Programs that are no browsers send none.
//! - The subprotocol is one that is spoken here.

use std::net::{IpAddr, SocketAddr};

use tokio_tungstenite::tungstenite::http::header::{HOST, ORIGIN, SEC_WEBSOCKET_PROTOCOL};
use tokio_tungstenite::tungstenite::http::{HeaderMap, HeaderName, StatusCode};

use crate::protocol::SUBPROTOCOLS;

/// Why a connection is refused.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub(crate) enum Refused {
    /// Another name for this machine.
    #[error("expected a Host that is localhost or a loopback address")]
    Host,
    /// A page of another place.
    #[error(
        "found the origin {found:?}, expected a page of this machine or one of the origins that are allowed"
    )]
    Origin {
        /// What the browser said.
        found: String,
    },
    /// Another protocol.
    #[error("expected Sec-WebSocket-Protocol with one of foxglove.sdk.v1, foxglove.websocket.v1")]
    Subprotocol,
    /// Too many viewers.
    #[error("as many viewers as may be are connected already")]
    Full,
}

impl Refused {
    pub(crate) fn status(&self) -> StatusCode {
        match self {
            Self::Host => StatusCode::MISDIRECTED_REQUEST,
            Self::Origin { .. } => StatusCode::FORBIDDEN,
            Self::Subprotocol => StatusCode::BAD_REQUEST,
            Self::Full => StatusCode::SERVICE_UNAVAILABLE,
        }
    }
}

/// Checks the headers of a handshake; the subprotocol that is spoken.
pub(crate) fn check(headers: &HeaderMap, origins: &[String]) -> Result<&'static str, Refused> {
    let text = |name: HeaderName| headers.get(name).map(|value| value.to_str().unwrap_or_default());
    if !text(HOST).is_some_and(is_here) {
        return Err(Refused::Host);
    }
    if let Some(origin) = text(ORIGIN)
        && !is_allowed(origin, origins)
    {
        return Err(Refused::Origin { found: origin.chars().take(200).collect() });
    }
    let offered = headers.get_all(SEC_WEBSOCKET_PROTOCOL).iter();
    let offered: Vec<&str> = offered.filter_map(|v| v.to_str().ok()).flat_map(|v| v.split(',')).collect();
    let spoken = |known: &&&str| offered.iter().any(|name| name.trim() == **known);
    SUBPROTOCOLS.iter().find(spoken).copied().ok_or(Refused::Subprotocol)
}

fn is_allowed(origin: &str, origins: &[String]) -> bool {
    if origins.iter().any(|allowed| allowed.trim_end_matches('/').eq_ignore_ascii_case(origin)) {
        return true;
    }
    // Only a program or a file on this machine has it; sandboxed pages of strangers are "null".
    if origin == "file://" {
        return true;
    }
    let host = origin.strip_prefix("http://").or_else(|| origin.strip_prefix("https://"));
    host.is_some_and(is_here)
}

/// A loopback address or `localhost`, with or without a port.
fn is_here(authority: &str) -> bool {
    if let Ok(address) = authority.parse::<SocketAddr>() {
        return address.ip().is_loopback();
    }
    let bare = authority.strip_prefix('[').and_then(|rest| rest.strip_suffix(']')).unwrap_or(authority);
    if let Ok(address) = bare.parse::<IpAddr>() {
        return address.is_loopback();
    }
    let (name, port) = authority.split_once(':').unwrap_or((authority, "0"));
    name.eq_ignore_ascii_case("localhost") && port.parse::<u16>().is_ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn asked(pairs: &[(HeaderName, &str)], origins: &[&str]) -> Result<&'static str, Refused> {
        let mut headers = HeaderMap::new();
        for (name, value) in pairs {
            headers.append(name, value.parse().unwrap());
        }
        let origins: Vec<String> = origins.iter().map(|&o| o.to_owned()).collect();
        check(&headers, &origins)
    }

    const SPEAKS: (HeaderName, &str) = (SEC_WEBSOCKET_PROTOCOL, "foxglove.websocket.v1");
    const HERE: (HeaderName, &str) = (HOST, "localhost:8765");

    #[test]
    fn names_of_this_machine_alone_are_hosts() {
        for good in ["localhost", "LOCALHOST:1", "127.0.0.1:8765", "127.9.0.1", "[::1]:8765", "[::1]"] {
            assert!(asked(&[(HOST, good), SPEAKS], &[]).is_ok(), "{good}");
        }
        let wrong = [
            "evil.example",
            "localhost.evil.example:8765",
            "127.0.0.1.evil.example",
            "192.0.2.7:8765",
            "localhost:1@evil.example",
            "localhost:",
            "[::1",
            "",
        ];
        for wrong in wrong {
            assert_eq!(asked(&[(HOST, wrong), SPEAKS], &[]), Err(Refused::Host), "{wrong}");
        }
        assert_eq!(asked(&[SPEAKS], &[]), Err(Refused::Host));
    }

    #[test]
    fn pages_of_strangers_stay_outside_unless_they_are_allowed() {
        let from = |origin, allowed: &[&str]| asked(&[HERE, (ORIGIN, origin), SPEAKS], allowed);
        for good in ["http://localhost:8080", "https://localhost", "http://127.0.0.1:3000", "file://"] {
            assert!(from(good, &[]).is_ok(), "{good}");
        }
        let strangers = [
            "https://evil.example",
            "null",
            "",
            "file://evil",
            "http://localhost.evil.example",
            "http://localhost@evil.example",
            "ftp://localhost",
            "https://app.foxglove.dev.evil.example",
        ];
        for stranger in strangers {
            let allowed = &["https://app.foxglove.dev/"];
            assert!(matches!(from(stranger, allowed), Err(Refused::Origin { .. })), "{stranger}");
        }
        assert!(from("https://app.foxglove.dev", &[]).is_err());
        assert!(from("https://app.foxglove.dev", &["https://app.foxglove.dev/"]).is_ok());
    }

    #[test]
    fn the_newest_protocol_that_both_speak_is_spoken() {
        let offer = |given: &'static str| asked(&[HERE, (SEC_WEBSOCKET_PROTOCOL, given)], &[]);
        assert_eq!(offer("foxglove.websocket.v1"), Ok("foxglove.websocket.v1"));
        assert_eq!(offer("foxglove.websocket.v1, foxglove.sdk.v1"), Ok("foxglove.sdk.v1"));
        assert_eq!(offer("foxglove.sdk.v1.1,foxglove.sdk.v1"), Ok("foxglove.sdk.v1"));
        for other in ["", "foxglove.sdk.v1.1", "foxglove.sdk.v2", "mqtt", "foxglove.websocket.v1x"] {
            assert_eq!(offer(other), Err(Refused::Subprotocol), "{other}");
        }
        assert_eq!(asked(&[HERE], &[]), Err(Refused::Subprotocol));
        let twice = [HERE, (SEC_WEBSOCKET_PROTOCOL, "mqtt"), SPEAKS];
        assert_eq!(asked(&twice, &[]), Ok("foxglove.websocket.v1"));
    }
}
