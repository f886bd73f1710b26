//! The page that a browser shows at the server's address: its files, gRPC-web beside gRPC, and who may ask for them.
//!
//! Native gRPC passes by. Calls of the page are gRPC-web, and are the same calls from there on: roles, quotas, deadlines
//! and metrics are those of the layer behind this one.

mod files;
mod gate;
#[cfg(test)]
mod schema;

use std::future::Future;
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll, ready};

use bytes::Bytes;
use hyper::header::{CONTENT_TYPE, HeaderName, HeaderValue};
use hyper::{Method, Request, Response, StatusCode, Version};
use tonic::body::Body;
use tonic::codegen::Service;
use tonic_web::{GrpcWebLayer, GrpcWebService};
use tower::Layer;

use crate::engine::Engine;
use crate::http;
use crate::service::Gatekeeper;
use gate::Stranger;

/// The page for browsers.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Page {
    /// What it shows before anybody has brought a frame.
    pub example: Option<Example>,
}

/// A frame that comes with the page.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Example {
    /// Depth, a 16-bit grey PNG.
    pub depth_png: Bytes,
    /// Its lens as JSON: `fx`, `fy`, `cx`, `cy`, `depth_scale`, and, where it is known, `camera_to_world`, the rows of
    /// a 4 x 4 matrix.
    pub frame_json: Bytes,
}

impl Example {
    /// A frame that is in the program.
    pub const fn from_static(depth_png: &'static [u8], frame_json: &'static [u8]) -> Self {
        Self { depth_png: Bytes::from_static(depth_png), frame_json: Bytes::from_static(frame_json) }
    }
}

/// What every answer says to the browser: scripts and styles from here alone, no frames, no guesses, no referrers.
const HEADERS: [(&str, &str); 6] = [
    (
        "content-security-policy",
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; connect-src 'self'; \
         base-uri 'none'; form-action 'none'; frame-ancestors 'none'; require-trusted-types-for 'script'; \
         trusted-types 'none'",
    ),
    ("x-content-type-options", "nosniff"),
    ("referrer-policy", "no-referrer"),
    ("cross-origin-opener-policy", "same-origin"),
    ("cross-origin-resource-policy", "same-origin"),
    // A new version of the server is a new page at once.
    ("cache-control", "no-cache"),
];

/// What the page's answers are made of.
#[derive(Debug)]
pub(crate) struct Site {
    pub(crate) page: Page,
    pub(crate) engine: Arc<Engine>,
    pub(crate) gatekeeper: Arc<Gatekeeper>,
    /// Connections are TLS.
    pub(crate) is_encrypted: bool,
    /// Limit of a request's headers, bytes.
    pub(crate) header_bytes: u32,
}

impl Site {
    /// The answer to a request that no browser of a user of this page sends.
    fn refusal(&self, request: &Request<Body>) -> Option<Response<Body>> {
        let is_document = request.uri().path() == "/";
        let stranger = gate::check(request, self.is_encrypted, is_document, self.header_bytes).err()?;
        let status = match stranger {
            Stranger::Host => StatusCode::MISDIRECTED_REQUEST,
            Stranger::Site => StatusCode::FORBIDDEN,
            Stranger::Headers => StatusCode::REQUEST_HEADER_FIELDS_TOO_LARGE,
        };
        Some(text(status, &stranger))
    }

    /// Answers everything that is no call.
    fn answer(&self, request: &Request<Body>) -> Response<Body> {
        if !matches!(*request.method(), Method::GET | Method::HEAD) {
            return text(
                StatusCode::METHOD_NOT_ALLOWED,
                &"only GET, and calls as application/grpc-web+proto",
            );
        }
        let path = request.uri().path();
        if let Some(file) = files::file(path) {
            return found(file.kind, Bytes::from_static(file.bytes));
        }
        match (path, &self.page.example) {
            ("/example/depth.png", Some(example)) => found("image/png", example.depth_png.clone()),
            ("/example/frame.json", Some(example)) => found("application/json", example.frame_json.clone()),
            ("/metrics", _) => match self.gatekeeper.identify(request) {
                Ok(_) => found(http::METRICS_TYPE, http::metrics(&self.engine).into()),
                Err(error) => text(StatusCode::UNAUTHORIZED, &error),
            },
            _ => text(StatusCode::NOT_FOUND, &"the page is at /"),
        }
    }
}

fn found(kind: &'static str, bytes: Bytes) -> Response<Body> {
    let mut response = Response::new(http::one_piece(bytes));
    let headers = response.headers_mut();
    headers.insert(CONTENT_TYPE, HeaderValue::from_static(kind));
    for (name, value) in HEADERS {
        headers.insert(HeaderName::from_static(name), HeaderValue::from_static(value));
    }
    response
}

fn text(status: StatusCode, words: &dyn std::fmt::Display) -> Response<Body> {
    let mut response = found("text/plain; charset=utf-8", format!("{words}\n").into());
    *response.status_mut() = status;
    response
}

/// Makes [`PageService`]s; without a site everything passes by.
#[derive(Debug, Clone)]
pub(crate) struct PageLayer(pub(crate) Option<Arc<Site>>);

impl<S: Clone> Layer<S> for PageLayer {
    type Service = PageService<S>;

    fn layer(&self, inner: S) -> Self::Service {
        PageService { web: GrpcWebLayer::new().layer(inner.clone()), inner, site: self.0.clone() }
    }
}

/// A service behind the layer.
#[derive(Debug, Clone)]
pub(crate) struct PageService<S> {
    inner: S,
    web: GrpcWebService<S>,
    site: Option<Arc<Site>>,
}

/// Who answers a request.
#[derive(Debug, PartialEq, Eq)]
enum Kind {
    /// gRPC as ever.
    Native,
    /// A call of a page.
    Web,
    /// A file, or nothing.
    Page,
}

fn kind<B>(request: &Request<B>) -> Kind {
    let content = request.headers().get(CONTENT_TYPE).map(HeaderValue::as_bytes).unwrap_or_default();
    if content.starts_with(b"application/grpc-web") {
        return Kind::Web;
    }
    let is_plain_get = *request.method() == Method::GET && !content.starts_with(b"application/grpc");
    if request.version() == Version::HTTP_2 && !is_plain_get { Kind::Native } else { Kind::Page }
}

impl<S> Service<Request<Body>> for PageService<S>
where
    S: Service<Request<Body>, Response = Response<Body>>,
    S::Future: Send + 'static,
    S::Error: Send + 'static,
{
    type Response = Response<Body>;
    type Error = S::Error;
    type Future = Pin<Box<dyn Future<Output = Result<Response<Body>, S::Error>> + Send>>;

    fn poll_ready(&mut self, context: &mut Context<'_>) -> Poll<Result<(), Self::Error>> {
        ready!(self.inner.poll_ready(context))?;
        Service::<Request<Body>>::poll_ready(&mut self.web, context)
    }

    fn call(&mut self, request: Request<Body>) -> Self::Future {
        let kind = kind(&request);
        let site = match &self.site {
            Some(site) if kind != Kind::Native => site,
            _ => return Box::pin(self.inner.call(request)),
        };
        let answer = match (site.refusal(&request), kind) {
            (Some(refusal), _) => refusal,
            (None, Kind::Web) => return Box::pin(self.web.call(request)),
            (None, _) => site.answer(&request),
        };
        Box::pin(std::future::ready(Ok(answer)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn native_calls_pass_by() {
        let kind = |version, method: &Method, content: Option<&str>| {
            let mut request = Request::builder().version(version).method(method).uri("/x");
            if let Some(content) = content {
                request = request.header(CONTENT_TYPE, content);
            }
            super::kind(&request.body(()).unwrap())
        };
        let (h1, h2) = (Version::HTTP_11, Version::HTTP_2);
        assert_eq!(kind(h2, &Method::POST, Some("application/grpc")), Kind::Native);
        assert_eq!(kind(h2, &Method::POST, Some("application/grpc+proto")), Kind::Native);
        assert_eq!(kind(h2, &Method::POST, None), Kind::Native);
        assert_eq!(kind(h2, &Method::GET, Some("application/grpc")), Kind::Native);
        assert_eq!(kind(h2, &Method::POST, Some("application/grpc-web+proto")), Kind::Web);
        assert_eq!(kind(h1, &Method::POST, Some("application/grpc-web")), Kind::Web);
        assert_eq!(kind(h2, &Method::GET, None), Kind::Page);
        assert_eq!(kind(h1, &Method::GET, None), Kind::Page);
        assert_eq!(kind(h1, &Method::POST, Some("application/grpc")), Kind::Page);
    }

    #[test]
    fn every_header_is_one() {
        let response = found("text/plain", Bytes::new());
        assert_eq!(response.headers().len(), HEADERS.len() + 1);
        let policy = response.headers()["content-security-policy"].to_str().unwrap();
        assert!(policy.starts_with("default-src 'none'") && !policy.contains("unsafe"));
        assert_eq!(text(StatusCode::FORBIDDEN, &Stranger::Site).status(), StatusCode::FORBIDDEN);
    }
}
