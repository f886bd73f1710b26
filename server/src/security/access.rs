//! Tokens, certificates and what they allow.
//!
//! Tokens are kept as SHA-256 only and compared in constant time with all there are. Certificates are known by the
//! SHA-256 of their DER bytes; one that the certificate authority vouches for and nobody has listed is a viewer.

use std::collections::BTreeMap;
use std::net::SocketAddr;

use ring::digest::{SHA256, digest};
use subtle::{Choice, ConditionallySelectable as _, ConstantTimeEq as _};

use crate::caller::Caller;
use crate::error::ServiceError;
use crate::pool::Priority;

/// What a caller may do; each may do what those before it may.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Role {
    /// Look at hands.
    Viewer,
    /// Plan.
    Controller,
    /// Create and delete hands.
    Operator,
}

impl Role {
    /// The role of that name.
    pub fn by_name(name: &str) -> Option<Self> {
        [Self::Viewer, Self::Controller, Self::Operator].into_iter().find(|role| role.name() == name)
    }

    /// Its name, in lower case.
    pub fn name(self) -> &'static str {
        match self {
            Self::Viewer => "viewer",
            Self::Controller => "controller",
            Self::Operator => "operator",
        }
    }

    /// The most urgent priority that a caller of this role may ask for where nothing else was said of it. Slots that are kept
    /// for servo work are for streams of `ServoGrasp`, which are counted, and for callers who were named for it.
    pub fn most_urgent(self) -> Priority {
        match self {
            Self::Viewer => Priority::Low,
            Self::Controller | Self::Operator => Priority::High,
        }
    }

    /// The role that a method asks for; one that is not in this table asks for the highest.
    pub(crate) fn of_method(path: &str) -> Self {
        match path {
            "/graspd.v1.HandService/ListHands"
            | "/graspd.v1.HandService/GetHand"
            | "/graspd.v1.HandService/GetHandGeometry"
            | "/graspd.v1.InfoService/GetServerInfo" => Self::Viewer,
            path if path.starts_with("/grpc.reflection.") => Self::Viewer,
            path if path.starts_with("/graspd.v1.PlannerService/") => Self::Controller,
            "/graspd.v1.ServoService/ServoGrasp" => Self::Controller,
            _ => Self::Operator,
        }
    }
}

/// A bearer token, by its hash.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Token {
    /// Whose it is; appears in logs and metrics.
    pub name: String,
    /// SHA-256 of the token's bytes.
    pub sha256: [u8; 32],
    /// What it allows.
    pub role: Role,
}

/// A client certificate, by its hash.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Certificate {
    /// Whose it is.
    pub name: String,
    /// SHA-256 of its DER bytes.
    pub sha256: [u8; 32],
    /// What it allows.
    pub role: Role,
}

/// Who may call.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Access {
    /// Tokens. With any, every call needs a token or a certificate.
    pub tokens: Vec<Token>,
    /// Certificates that are more than viewers.
    pub certificates: Vec<Certificate>,
    /// The most urgent priority that callers of these names may ask for; for who is not here their role says it
    /// ([`Role::most_urgent`]).
    pub most_urgent: BTreeMap<String, Priority>,
}

/// Why an access list is not one.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{field}: found {found}, expected {expected}")]
pub struct WrongAccess {
    /// Which entry.
    pub field: String,
    /// What was there.
    pub found: String,
    /// What should have been.
    pub expected: &'static str,
}

impl Access {
    /// Checks that names are there once and hashes are not those of nothing.
    ///
    /// # Errors
    /// [`WrongAccess`] for the first that is wrong.
    pub fn check(&self) -> Result<(), WrongAccess> {
        let tokens = self.tokens.iter().map(|t| ("token", &t.name, &t.sha256));
        let entries = tokens.chain(self.certificates.iter().map(|c| ("certificate", &c.name, &c.sha256)));
        let mut names = std::collections::BTreeSet::new();
        for name in self.most_urgent.keys() {
            let named = self.tokens.iter().any(|t| t.name == *name);
            if !named && !self.certificates.iter().any(|c| c.name == *name) {
                let (field, found) = ("most_urgent".to_owned(), format!("{name:?}"));
                return Err(WrongAccess { field, found, expected: "the name of a token or a certificate" });
            }
        }
        let empty = digest(&SHA256, b"");
        for (i, (kind, name, sha256)) in entries.enumerate() {
            let field = |key: &str| format!("access entry {} ({kind} {name:?}): {key}", i + 1);
            let sane = !name.is_empty() && name.len() <= 64 && name.chars().all(|c| c.is_ascii_graphic());
            if !sane || name.parse::<std::net::IpAddr>().is_ok() {
                let expected = "1 to 64 visible ASCII characters that are no address";
                return Err(WrongAccess { field: field("name"), found: format!("{name:?}"), expected });
            }
            if !names.insert(name) {
                let expected = "a name that no other entry has";
                return Err(WrongAccess { field: field("name"), found: format!("{name:?}"), expected });
            }
            if sha256.as_slice() == empty.as_ref() {
                let expected = "the hash of a token that is not empty";
                return Err(WrongAccess {
                    field: field("sha256"),
                    found: "that of nothing".to_owned(),
                    expected,
                });
            }
        }
        Ok(())
    }
}

/// What a call brings to say who it is from.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Credentials<'a> {
    pub(crate) peer: Option<SocketAddr>,
    /// SHA-256 of the certificate that the connection was made with.
    pub(crate) certificate: Option<[u8; 32]>,
    /// The header, as sent.
    pub(crate) authorization: Option<&'a [u8]>,
}

/// Somebody who may call.
#[derive(Debug, Clone)]
pub(crate) struct Identity {
    pub(crate) caller: Caller,
    pub(crate) role: Role,
}

impl Access {
    /// Who calls. Anonymous callers are operators where nobody needs to say who they are.
    pub(crate) fn identify(
        &self,
        credentials: &Credentials<'_>,
        required: bool,
    ) -> Result<Identity, ServiceError> {
        if let Some(header) = credentials.authorization {
            let token = header.strip_prefix(b"Bearer ").or_else(|| header.strip_prefix(b"bearer "));
            let token =
                token.ok_or(ServiceError::Unauthenticated { problem: "expected \"Bearer TOKEN\"" })?;
            if let Some(token) = self.token(token) {
                return Ok(Identity { caller: self.caller(&token.name, token.role), role: token.role });
            }
            if required {
                return Err(ServiceError::Unauthenticated { problem: "the token is not known here" });
            }
        }
        if let Some(sha256) = credentials.certificate {
            let listed = self.certificates.iter().find(|c| c.sha256 == sha256);
            return Ok(match listed {
                Some(c) => Identity { caller: self.caller(&c.name, c.role), role: c.role },
                None => {
                    let head: String = sha256.iter().take(8).map(|byte| format!("{byte:02x}")).collect();
                    Identity {
                        caller: self.caller(&format!("certificate-{head}"), Role::Viewer),
                        role: Role::Viewer,
                    }
                }
            });
        }
        if required {
            return Err(ServiceError::Unauthenticated {
                problem: "expected a token or a client certificate",
            });
        }
        Ok(Identity { caller: Caller::anonymous(credentials.peer), role: Role::Operator })
    }

    fn caller(&self, name: &str, role: Role) -> Caller {
        let most_urgent = self.most_urgent.get(name).copied().unwrap_or_else(|| role.most_urgent());
        Caller { most_urgent, ..Caller::named(name) }
    }

    /// The token with this text. Looks at all of them, so that time tells nothing.
    fn token(&self, text: &[u8]) -> Option<&Token> {
        let hash = digest(&SHA256, text);
        let mut found = u64::MAX;
        for (i, token) in self.tokens.iter().enumerate() {
            let same: Choice = token.sha256.as_slice().ct_eq(hash.as_ref());
            found.conditional_assign(&(i as u64), same);
        }
        usize::try_from(found).ok().and_then(|i| self.tokens.get(i))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn hash(text: &[u8]) -> [u8; 32] {
        digest(&SHA256, text).as_ref().try_into().unwrap()
    }

    fn access() -> Access {
        let token = |name: &str, text: &[u8], role| Token { name: name.to_owned(), sha256: hash(text), role };
        Access {
            tokens: vec![
                token("arm", b"secret-1", Role::Controller),
                token("desk", b"secret-2", Role::Operator),
            ],
            certificates: vec![Certificate {
                name: "cell".to_owned(),
                sha256: [7; 32],
                role: Role::Controller,
            }],
            most_urgent: BTreeMap::from([("arm".to_owned(), Priority::Normal)]),
        }
    }

    fn identify(
        authorization: Option<&[u8]>,
        certificate: Option<[u8; 32]>,
        required: bool,
    ) -> Option<(String, Role)> {
        let peer = Some(SocketAddr::from(([127, 0, 0, 1], 9)));
        let found = access().identify(&Credentials { peer, certificate, authorization }, required);
        found.ok().map(|who| (who.caller.name.to_string(), who.role))
    }

    #[test]
    fn tokens_and_certificates_say_who_calls() {
        let who = |name: &str, role| Some((name.to_owned(), role));
        assert_eq!(identify(Some(b"Bearer secret-1"), None, true), who("arm", Role::Controller));
        assert_eq!(identify(Some(b"bearer secret-2"), None, true), who("desk", Role::Operator));
        for wrong in [&b"Bearer secret-3"[..], b"Bearer ", b"Bearer", b"secret-1", b"Basic secret-1", b"\xff"]
        {
            assert_eq!(identify(Some(wrong), None, true), None, "{wrong:?}");
        }
        // A wrong token is not made good by a certificate.
        assert_eq!(identify(Some(b"Bearer wrong"), Some([7; 32]), true), None);
        assert_eq!(identify(None, Some([7; 32]), true), who("cell", Role::Controller));
        assert_eq!(identify(None, Some([9; 32]), true), who("certificate-0909090909090909", Role::Viewer));
        assert_eq!(identify(None, None, true), None);
        assert_eq!(identify(None, None, false), who("127.0.0.1", Role::Operator));
        let urgent = |text: &[u8]| {
            let credentials = Credentials { peer: None, certificate: None, authorization: Some(text) };
            access().identify(&credentials, true).unwrap().caller.most_urgent
        };
        assert_eq!(urgent(b"Bearer secret-1"), Priority::Normal);
        assert_eq!(urgent(b"Bearer secret-2"), Priority::High);
        let most_urgent = |certificate, required| {
            let credentials = Credentials { peer: None, certificate, authorization: None };
            access().identify(&credentials, required).unwrap().caller.most_urgent
        };
        assert_eq!(most_urgent(Some([7; 32]), true), Priority::High);
        assert_eq!(most_urgent(Some([9; 32]), true), Priority::Low);
        // Where nobody says who they are, nobody can be told apart.
        assert_eq!(most_urgent(None, false), Priority::Servo);
    }

    #[test]
    fn methods_ask_for_roles_and_unknown_ones_for_the_highest() {
        let table = [
            ("/graspd.v1.HandService/ListHands", Role::Viewer),
            ("/graspd.v1.HandService/GetHand", Role::Viewer),
            ("/graspd.v1.HandService/GetHandGeometry", Role::Viewer),
            ("/graspd.v1.InfoService/GetServerInfo", Role::Viewer),
            ("/graspd.v1.HandService/CreateHand", Role::Operator),
            ("/graspd.v1.HandService/DeleteHand", Role::Operator),
            ("/graspd.v1.PlannerService/PlanGrasps", Role::Controller),
            ("/graspd.v1.PlannerService/StreamGrasps", Role::Controller),
            ("/graspd.v1.PlannerService/PlanMultiHand", Role::Controller),
            ("/graspd.v1.PlannerService/ReadScene", Role::Controller),
            ("/graspd.v1.ServoService/ServoGrasp", Role::Controller),
            ("/graspd.v1.Nothing/Nothing", Role::Operator),
            ("/", Role::Operator),
        ];
        for (path, role) in table {
            assert_eq!(Role::of_method(path), role, "{path}");
        }
        assert!(Role::Viewer < Role::Controller && Role::Controller < Role::Operator);
    }

    #[test]
    fn a_wrong_list_is_named_precisely() {
        access().check().unwrap();
        let with = |name: &str, sha256| {
            let mut access = access();
            access.tokens.push(Token { name: name.to_owned(), sha256, role: Role::Viewer });
            access.check().unwrap_err().to_string()
        };
        assert!(with("arm", [1; 32]).contains("token \"arm\""));
        let mut nobody = access();
        nobody.most_urgent.insert("nobody".to_owned(), Priority::Low);
        assert!(nobody.check().unwrap_err().to_string().contains("\"nobody\""));
        assert!(with("", [1; 32]).contains("1 to 64"));
        assert!(with("127.0.0.1", [1; 32]).contains("no address"));
        assert!(with("new", hash(b"")).contains("not empty"));
    }
}
