//! What a browser's request must look like. A browser carries requests of any site that its user visits to this machine:
//! whoever has no site of their own here must not get an answer, nor an effect.
//!
//! - `Host` is an address or `localhost` where there is no TLS: a name would be one that somebody has pointed at this
//!   machine (DNS rebinding). With TLS the certificate has said so.
//! - `Origin`, where there is one, is the page's own, and `Sec-Fetch-Site` says that too, but for the page itself,
//!   to which others may link.

use std::net::{Ipv4Addr, Ipv6Addr};

use hyper::Request;
use hyper::header::{HOST, ORIGIN};

/// Why a request is not answered.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub(super) enum Stranger {
    /// The name of another place.
    #[error("expected a Host that is an address or localhost; a name could be anybody's")]
    Host,
    /// From the page of another place.
    #[error("expected a request of the page's own; this one is another site's")]
    Site,
    /// More headers than the limit.
    #[error("the headers are too long")]
    Headers,
}

/// Checks a request; `is_document` for what a person goes to, which others may link to.
pub(super) fn check<B>(
    request: &Request<B>,
    is_encrypted: bool,
    is_document: bool,
    header_bytes: u32,
) -> Result<(), Stranger> {
    let total: usize = request.headers().iter().map(|(name, value)| name.as_str().len() + value.len()).sum();
    if total > usize::try_from(header_bytes).unwrap_or(usize::MAX) {
        return Err(Stranger::Headers);
    }
    let header = |name: &str| request.headers().get(name).map(|value| value.to_str().unwrap_or_default());
    // HTTP/2 has it in the URI.
    let host = request.uri().authority().map(|a| a.as_str()).or_else(|| header(HOST.as_str()));
    let host = host.ok_or(Stranger::Host)?;
    if !is_encrypted && !is_address(host) {
        return Err(Stranger::Host);
    }
    if let Some(origin) = header(ORIGIN.as_str()) {
        let same =
            origin.split_once("://").is_some_and(|(_, authority)| authority.eq_ignore_ascii_case(host));
        if !same {
            return Err(Stranger::Site);
        }
    }
    match header("sec-fetch-site") {
        None | Some("same-origin" | "none") => Ok(()),
        Some(_) if is_document => Ok(()),
        Some(_) => Err(Stranger::Site),
    }
}

/// An address or `localhost`, with or without a port.
fn is_address(host: &str) -> bool {
    if let Some(rest) = host.strip_prefix('[') {
        let Some((address, port)) = rest.split_once(']') else { return false };
        return address.parse::<Ipv6Addr>().is_ok() && (port.is_empty() || is_port(port));
    }
    let (name, port) = host.find(':').map_or((host, ""), |colon| host.split_at(colon));
    (name.parse::<Ipv4Addr>().is_ok() || name.eq_ignore_ascii_case("localhost"))
        && (port.is_empty() || is_port(port))
}

fn is_port(text: &str) -> bool {
    text.strip_prefix(':').is_some_and(|port| port.parse::<u16>().is_ok())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn asked(headers: &[(&str, &str)], is_encrypted: bool, is_document: bool) -> Result<(), Stranger> {
        let mut request = Request::builder().uri("/page/main.js");
        for (name, value) in headers {
            request = request.header(*name, *value);
        }
        check(&request.body(()).unwrap(), is_encrypted, is_document, 1000)
    }

    #[test]
    fn only_addresses_are_hosts_without_encryption() {
        for good in ["127.0.0.1:50051", "localhost", "LOCALHOST:1", "[::1]:50051", "[::1]", "192.0.2.7:80"] {
            assert_eq!(asked(&[("host", good)], false, false), Ok(()), "{good}");
        }
        let wrong = [
            "evil.example",
            "127.0.0.1.evil.example:50051",
            "localhost.evil.example",
            "127.0.0.1:x",
            "[::1",
            "[::1]x",
            "localhost:1@evil.example",
            "",
        ];
        for wrong in wrong {
            assert_eq!(asked(&[("host", wrong)], false, true), Err(Stranger::Host), "{wrong}");
        }
        assert_eq!(asked(&[], false, true), Err(Stranger::Host));
        assert_eq!(asked(&[("host", "planner.example")], true, false), Ok(()));
    }

    #[test]
    fn other_sites_get_nothing_but_the_link_to_the_page() {
        let host = ("host", "127.0.0.1:50051");
        let with = |name, value, is_document| asked(&[host, (name, value)], false, is_document);
        assert_eq!(with("origin", "http://127.0.0.1:50051", false), Ok(()));
        let others = [
            "http://evil.example",
            "null",
            "",
            "http://127.0.0.1:50052",
            "http://localhost:50051",
            "127.0.0.1:50051",
        ];
        for other in others {
            assert_eq!(with("origin", other, true), Err(Stranger::Site), "{other}");
        }
        assert_eq!(with("sec-fetch-site", "same-origin", false), Ok(()));
        assert_eq!(with("sec-fetch-site", "none", false), Ok(()));
        for other in ["cross-site", "same-site", "?"] {
            assert_eq!(with("sec-fetch-site", other, false), Err(Stranger::Site), "{other}");
            assert_eq!(with("sec-fetch-site", other, true), Ok(()), "{other}");
        }
    }

    #[test]
    fn headers_have_a_limit() {
        let long = "x".repeat(1000);
        assert_eq!(asked(&[("host", "localhost"), ("cookie", &long)], false, true), Err(Stranger::Headers));
    }
}
