//! The errors in replies. Their texts never contain credentials.

use serde::Serialize;

/// A failed command: a code for programs and a text for people.
#[derive(Debug, Serialize)]
pub struct Fault {
    /// `not_found`, `denied`, `changed`, `checksum`, `credentials`, `local`, `invalid`, `stalled` or
    /// `failed`.
    pub code: &'static str,
    /// The reason.
    pub why: String,
}

pub type Result<T> = std::result::Result<T, Fault>;

impl Fault {
    pub fn new(code: &'static str, why: impl Into<String>) -> Fault {
        let why = why.into();
        Fault { code, why }
    }

    /// Builds the error of an operation on a local file.
    pub fn local(what: &str, path: &str, error: &std::io::Error) -> Fault {
        Fault::new("local", format!("could not {what} {path}: {error}"))
    }
}

/// The codes of services that refuse a request.
const DENIALS: [&str; 6] = [
    "AccessDenied",
    "InvalidAccessKeyId",
    "SignatureDoesNotMatch",
    "ExpiredToken",
    "InvalidToken",
    "AllAccessDisabled",
];

/// Returns the text of the first XML element of this name.
fn find_element<'a>(text: &'a str, name: &str) -> Option<&'a str> {
    let (_, rest) = text.split_once(&format!("<{name}>"))?;
    Some(rest.split_once(&format!("</{name}>"))?.0)
}

/// Describes an error without the service's reply, which may contain a signature. Only code and
/// message of a reply in XML remain.
fn describe_error(error: &dyn std::error::Error) -> String {
    let mut text = error.to_string();
    let mut source = error.source();
    while let Some(inner) = source {
        let more = inner.to_string();
        if !text.contains(&more) {
            text = format!("{text}: {more}");
        }
        source = inner.source();
    }
    if let (Some(code), message) = (find_element(&text, "Code"), find_element(&text, "Message")) {
        return format!("{code}: {}", message.unwrap_or("no details"));
    }
    let line = text.split('<').next().unwrap_or_default();
    line.chars().take(400).collect()
}

impl From<object_store::Error> for Fault {
    fn from(error: object_store::Error) -> Fault {
        use object_store::Error;
        let why = describe_error(&error);
        let code = match &error {
            Error::NotFound { .. } => "not_found",
            Error::PermissionDenied { .. } | Error::Unauthenticated { .. } => "denied",
            Error::Precondition { .. } | Error::NotModified { .. } => "changed",
            Error::InvalidPath { .. } => "invalid",
            _ if DENIALS.iter().any(|denial| why.starts_with(denial)) => "denied",
            _ if why.starts_with("NoSuchBucket") => "not_found",
            _ => "failed",
        };
        Fault { code, why }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn errors_keep_only_code_and_message_of_a_reply() {
        let reply = "status 403: <Error><Code>SignatureDoesNotMatch</Code><Message>It does not match.</Message>\
                     <AWSAccessKeyId>AKIA1</AWSAccessKeyId><SignatureProvided>abc</SignatureProvided></Error>";
        let why = describe_error(&std::io::Error::other(reply));
        assert_eq!(why, "SignatureDoesNotMatch: It does not match.");
        let why = describe_error(&std::io::Error::other("no <html>reply</html>"));
        assert_eq!(why, "no ");
    }
}
