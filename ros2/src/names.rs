//! Names of topics and services: what a user writes, made absolute as ROS does it.

use ros2_client::Name;

/// A name that ROS does not have.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{found:?}: {problem}; expected a name like depth/image, /camera/depth or ~/image")]
pub struct NameError {
    /// What was written.
    pub found: String,
    /// What is wrong with it.
    pub problem: String,
}

/// `/a` stays, `a` is in the namespace, `~/a` under the node's own name.
pub fn absolute(name: &str, namespace: &str, node: &str) -> String {
    let namespace = namespace.trim_end_matches('/');
    match (name.strip_prefix('/'), name.strip_prefix("~/")) {
        (Some(_), _) => name.to_owned(),
        (None, Some(own)) => format!("{namespace}/{node}/{own}"),
        (None, None) => format!("{namespace}/{name}"),
    }
}

/// The same as the middleware wants it.
///
/// # Errors
/// [`NameError`].
pub fn resolve(name: &str, namespace: &str, node: &str) -> Result<Name, NameError> {
    Name::parse(&absolute(name, namespace, node))
        .map_err(|error| NameError { found: name.to_owned(), problem: error.to_string() })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_made_absolute() {
        assert_eq!(absolute("/camera/depth", "/cell", "graspd"), "/camera/depth");
        assert_eq!(absolute("camera/depth", "/cell", "graspd"), "/cell/camera/depth");
        assert_eq!(absolute("camera/depth", "/", "graspd"), "/camera/depth");
        assert_eq!(absolute("~/goal", "/", "graspd"), "/graspd/goal");
        assert_eq!(absolute("~/goal", "/a/b", "graspd"), "/a/b/graspd/goal");
    }

    #[test]
    fn what_is_no_name_is_refused() {
        assert_eq!(resolve("~/goal", "/", "graspd").unwrap().to_string(), "/graspd/goal");
        for wrong in ["", "/", "a b", "/a//b", "a/", "/2d/image", "a__b", "~image"] {
            assert_eq!(resolve(wrong, "/", "graspd").unwrap_err().found, wrong);
        }
    }
}
