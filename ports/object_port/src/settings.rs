//! Finds credentials, region and endpoint like the AWS tools: in the environment, then in `~/.aws/credentials` and
//! `~/.aws/config`.

use std::collections::HashMap;
use std::path::PathBuf;
use std::time::Duration;

use object_store::aws::{AmazonS3, AmazonS3Builder, AmazonS3ConfigKey};
use object_store::{BackoffConfig, ClientOptions, RetryConfig};

use crate::fault::{Fault, Result};
use crate::meter::CountingConnector;

type Profile = HashMap<String, String>;

/// Parses a section of an INI file. Returns `None` if the file has no such section.
fn parse_profile(text: &str, headings: &[String]) -> Option<Profile> {
    let mut found: Option<Profile> = None;
    let mut inside = false;
    for line in text.lines().map(str::trim) {
        if let Some(heading) = line.strip_prefix('[') {
            let heading = heading.trim_end_matches(']').trim();
            inside = headings.iter().any(|h| h == heading);
            if inside {
                found.get_or_insert_with(Profile::new);
            }
        } else if let (true, Some((key, value)), Some(profile)) =
            (inside, line.split_once('='), found.as_mut())
        {
            if !line.starts_with('#') {
                profile.insert(key.trim().to_owned(), value.trim().to_owned());
            }
        }
    }
    found
}

fn read_profile(variable: &str, file: &str, headings: &[String]) -> Option<Profile> {
    let path = std::env::var_os(variable).map(PathBuf::from).or_else(|| {
        let home = std::env::var_os("HOME")?;
        Some(PathBuf::from(home).join(".aws").join(file))
    })?;
    parse_profile(&std::fs::read_to_string(path).ok()?, headings)
}

fn find_variable(names: &[&str]) -> Option<String> {
    names
        .iter()
        .find_map(|name| std::env::var(name).ok().filter(|value| !value.is_empty()))
}

/// The credentials and the place of a service.
struct Settings {
    keys: Option<(String, String, Option<String>)>,
    region: String,
    endpoint: Option<String>,
}

fn find_settings() -> Result<Settings> {
    let wanted = find_variable(&["AWS_PROFILE"]);
    let name = wanted.clone().unwrap_or_else(|| "default".into());
    let headings = [name.clone(), format!("profile {name}")];
    let secrets = read_profile("AWS_SHARED_CREDENTIALS_FILE", "credentials", &headings);
    let config = read_profile("AWS_CONFIG_FILE", "config", &headings);
    if let (Some(wanted), None, None) = (&wanted, &secrets, &config) {
        let why = format!("AWS_PROFILE names the profile {wanted:?}, which is in neither file");
        return Err(Fault::new("credentials", why));
    }
    let (secrets, config) = (secrets.unwrap_or_default(), config.unwrap_or_default());
    let of_profile = |key: &str| secrets.get(key).or_else(|| config.get(key)).cloned();
    let keys = match find_variable(&["AWS_ACCESS_KEY_ID"]) {
        Some(id) => {
            let secret = find_variable(&["AWS_SECRET_ACCESS_KEY"]).ok_or_else(|| {
                let why = "AWS_ACCESS_KEY_ID is set, but AWS_SECRET_ACCESS_KEY is not";
                Fault::new("credentials", why)
            })?;
            Some((id, secret, find_variable(&["AWS_SESSION_TOKEN"])))
        }
        None => of_profile("aws_access_key_id")
            .zip(of_profile("aws_secret_access_key"))
            .map(|(id, secret)| (id, secret, of_profile("aws_session_token"))),
    };
    let region = find_variable(&["AWS_REGION", "AWS_DEFAULT_REGION"])
        .or_else(|| of_profile("region"))
        .unwrap_or_else(|| "us-east-1".into());
    let endpoint = find_variable(&["AWS_ENDPOINT_URL_S3", "AWS_ENDPOINT_URL", "AWS_ENDPOINT"])
        .or_else(|| of_profile("endpoint_url"));
    Ok(Settings {
        keys,
        region,
        endpoint,
    })
}

/// Whether the environment names other sources of credentials: a role, a container, or none at all.
fn has_other_credentials() -> bool {
    let names = [
        "AWS_WEB_IDENTITY_TOKEN_FILE",
        "AWS_CONTAINER_CREDENTIALS_RELATIVE_URI",
        "AWS_CONTAINER_CREDENTIALS_FULL_URI",
        "AWS_SKIP_SIGNATURE",
    ];
    find_variable(&names).is_some()
}

/// Returns the number of seconds in an environment variable, or the default.
fn find_seconds(name: &str, default: u64) -> Duration {
    let seconds = find_variable(&[name]).and_then(|text| text.parse().ok());
    Duration::from_secs(seconds.unwrap_or(default))
}

/// Returns the limit for repeated failures of a request, and for silence in the middle of a reply.
pub fn find_timeout() -> Duration {
    find_seconds("SITU_S3_TIMEOUT", 60).max(Duration::from_secs(1))
}

/// Opens a bucket. Nothing is sent yet.
pub fn open_bucket(bucket: &str) -> Result<AmazonS3> {
    let settings = find_settings()?;
    let elsewhere = settings.endpoint.is_some();
    let timeout = find_timeout();
    let client = ClientOptions::new()
        .with_allow_http(elsewhere)
        .with_connect_timeout(Duration::from_secs(5))
        // The slowest connection that is useful needs this for 8 MiB.
        .with_timeout(timeout * 5);
    let retry = RetryConfig {
        backoff: BackoffConfig::default(),
        max_retries: 20,
        retry_timeout: timeout,
    };
    let mut builder = AmazonS3Builder::from_env()
        .with_bucket_name(bucket)
        .with_region(settings.region)
        .with_client_options(client)
        .with_retry(retry)
        .with_http_connector(CountingConnector);
    if let Some(endpoint) = settings.endpoint {
        let address = endpoint.trim_end_matches('/').to_owned();
        builder = builder.with_config(AmazonS3ConfigKey::S3Endpoint, address);
    }
    if let Some((id, secret, token)) = settings.keys {
        builder = builder
            .with_access_key_id(id)
            .with_secret_access_key(secret);
        if let Some(token) = token {
            builder = builder.with_token(token);
        }
    } else if elsewhere && !has_other_credentials() {
        let why = "there are none in the environment, ~/.aws/credentials or ~/.aws/config";
        return Err(Fault::new("credentials", why));
    }
    Ok(builder.build()?)
}

/// Returns the endpoint, which identifies the service in caches. It contains no credentials.
pub fn find_endpoint() -> Result<String> {
    let settings = find_settings()?;
    let endpoint = settings
        .endpoint
        .unwrap_or_else(|| format!("aws:{}", settings.region));
    // A user may have put a password into the address.
    Ok(match endpoint.split_once('@') {
        Some((_, host)) => host.to_owned(),
        None => endpoint,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn finds_the_section_of_a_profile() {
        let text = "[default]\naws_access_key_id = a\n\n[profile lab]\n# key = no\nregion=eu-1\n[x]\nregion = y\n";
        let lab = parse_profile(text, &["lab".into(), "profile lab".into()]).unwrap_or_default();
        assert_eq!(lab.len(), 1);
        assert_eq!(lab.get("region").map(String::as_str), Some("eu-1"));
        assert!(parse_profile(text, &["none".into()]).is_none());
    }
}
