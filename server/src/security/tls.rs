//! Certificates: read from files, and read again when the files change.

use std::path::{Path, PathBuf};
use std::sync::{Arc, PoisonError, RwLock};
use std::time::{Duration, SystemTime};

use ring::digest::{SHA256, digest};
use tokio_rustls::TlsAcceptor;
use tokio_rustls::rustls::crypto::ring::default_provider;
use tokio_rustls::rustls::pki_types::pem::PemObject as _;
use tokio_rustls::rustls::pki_types::{CertificateDer, PrivateKeyDer};
use tokio_rustls::rustls::server::WebPkiClientVerifier;
use tokio_rustls::rustls::{self, RootCertStore, ServerConfig};

/// How often the files are looked at.
const LOOK_EVERY: Duration = Duration::from_secs(1);

/// Files of certificates, PEM.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Tls {
    /// The server's certificate, then those between it and its root.
    pub certificate: PathBuf,
    /// Its private key.
    pub key: PathBuf,
    /// Roots of client certificates; with these, clients may show one.
    pub client_roots: Option<PathBuf>,
    /// Refuse connections without a client certificate.
    pub require_client_certificate: bool,
}

/// Why certificates cannot be used.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum TlsError {
    /// A file cannot be read, or has no PEM of that kind.
    #[error("{}: cannot be used as {what}: {problem}", path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// What it should be.
        what: &'static str,
        /// What is wrong.
        problem: String,
    },
    /// The parts do not fit each other.
    #[error("{} and its key: {source}", path.display())]
    Pair {
        /// The certificate.
        path: PathBuf,
        /// What is wrong.
        source: rustls::Error,
    },
}

impl Tls {
    fn load(&self) -> Result<Arc<ServerConfig>, TlsError> {
        let certificates = certificates_of(&self.certificate, "a certificate")?;
        let key = PrivateKeyDer::from_pem_file(&self.key)
            .map_err(|e| fault(&self.key, "a private key", e.to_string()))?;
        let provider = Arc::new(default_provider());
        let pair = |source| TlsError::Pair { path: self.certificate.clone(), source };
        let builder =
            ServerConfig::builder_with_provider(Arc::clone(&provider)).with_safe_default_protocol_versions();
        let builder = builder.map_err(pair)?;
        let builder = match &self.client_roots {
            None => builder.with_no_client_auth(),
            Some(path) => {
                let what = "roots of client certificates";
                let mut roots = RootCertStore::empty();
                for certificate in certificates_of(path, what)? {
                    roots.add(certificate).map_err(|e| fault(path, what, e.to_string()))?;
                }
                let verifier = WebPkiClientVerifier::builder_with_provider(Arc::new(roots), provider);
                let verifier =
                    if self.require_client_certificate { verifier } else { verifier.allow_unauthenticated() };
                builder.with_client_cert_verifier(
                    verifier.build().map_err(|e| fault(path, what, e.to_string()))?,
                )
            }
        };
        let mut config = builder.with_single_cert(certificates, key).map_err(pair)?;
        config.alpn_protocols = vec![b"h2".to_vec()];
        Ok(Arc::new(config))
    }

    /// When the newest of the files was changed.
    fn changed(&self) -> Option<Vec<SystemTime>> {
        let files = [Some(&self.certificate), Some(&self.key), self.client_roots.as_ref()];
        files.into_iter().flatten().map(|p| std::fs::metadata(p).and_then(|m| m.modified()).ok()).collect()
    }
}

fn fault(path: &Path, what: &'static str, problem: String) -> TlsError {
    TlsError::File { path: path.to_owned(), what, problem }
}

fn certificates_of(path: &Path, what: &'static str) -> Result<Vec<CertificateDer<'static>>, TlsError> {
    let read = CertificateDer::pem_file_iter(path).map_err(|e| fault(path, what, e.to_string()))?;
    let all = read.collect::<Result<Vec<_>, _>>().map_err(|e| fault(path, what, e.to_string()))?;
    if all.is_empty() {
        return Err(fault(path, what, "found no certificate in it".to_owned()));
    }
    Ok(all)
}

/// Makes TLS connections with the certificates as they are now.
#[derive(Clone)]
pub(crate) struct Acceptor {
    files: Tls,
    current: Arc<RwLock<Arc<ServerConfig>>>,
}

impl std::fmt::Debug for Acceptor {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Acceptor").field("files", &self.files).finish_non_exhaustive()
    }
}

impl Acceptor {
    /// Reads the files.
    pub(crate) fn new(files: Tls) -> Result<Self, TlsError> {
        let current = Arc::new(RwLock::new(files.load()?));
        Ok(Self { files, current })
    }

    /// For the next connection.
    pub(crate) fn now(&self) -> TlsAcceptor {
        TlsAcceptor::from(Arc::clone(&self.current.read().unwrap_or_else(PoisonError::into_inner)))
    }

    /// Reads the files again whenever they have changed; what cannot be used is told and left alone.
    pub(crate) async fn watch(self) {
        let mut seen = self.files.changed();
        loop {
            tokio::time::sleep(LOOK_EVERY).await;
            let now = self.files.changed();
            if now == seen {
                continue;
            }
            match self.files.load() {
                Ok(config) => {
                    *self.current.write().unwrap_or_else(PoisonError::into_inner) = config;
                    tracing::info!("certificates were read again");
                    seen = now;
                }
                // Half of a pair may have been written: the next look tries again.
                Err(error) => {
                    tracing::error!(%error, "changed certificates cannot be used; the old ones stay")
                }
            }
        }
    }
}

/// SHA-256 of a certificate.
pub(crate) fn fingerprint(certificate: &CertificateDer<'_>) -> [u8; 32] {
    let mut hash = [0; 32];
    hash.copy_from_slice(digest(&SHA256, certificate.as_ref()).as_ref());
    hash
}
