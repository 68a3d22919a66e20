//! Access that a config's rules leave a program.

use serde_json::Value;
use zenoh::Config;
use zenoh::key_expr::KeyExpr;

/// True if the config's own rules let the program subscribe to some keys of this expression. What a router lets through it
/// decides by itself.
pub fn may_subscribe(config: &Config, key: &str) -> bool {
    let rules = config.get_json("access_control").ok().and_then(|text| serde_json::from_str::<Value>(&text).ok());
    let Some(rules) = rules.filter(|rules| rules["enabled"] == true && rules["default_permission"] == "deny") else {
        return true;
    };
    let lists = |list: &Value, word: &str| list.as_array().is_none_or(|words| words.iter().any(|found| found == word));
    let meets = |found: &Value| {
        let [found, key] = [found.as_str().unwrap_or_default(), key].map(|text| KeyExpr::try_from(text.to_owned()));
        found.is_ok_and(|found| key.is_ok_and(|key| found.intersects(&key)))
    };
    let allows = |rule: &Value| {
        rule["permission"] == "allow"
            && lists(&rule["flows"], "egress")
            && lists(&rule["messages"], "declare_subscriber")
            && rule["key_exprs"].as_array().is_some_and(|keys| keys.iter().any(meets))
    };
    rules["rules"].as_array().is_some_and(|rules| rules.iter().any(allows))
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    #[test]
    fn rules_of_a_policy_leave_no_records() {
        let config = |key: &str, enabled: bool| {
            let text = format!(
                r#"{{ access_control: {{ enabled: {enabled}, default_permission: "deny",
                    rules: [{{ id: "a", permission: "allow", flows: ["egress"], messages: ["declare_subscriber"],
                               key_exprs: ["{key}"] }}],
                    subjects: [{{ id: "router" }}], policies: [{{ rules: ["a"], subjects: ["router"] }}] }} }}"#
            );
            Config::from_json5(&text).unwrap()
        };
        let rows = "fiatlux/v3/*/s/*/truth/row";
        assert!(may_subscribe(&Config::default(), rows));
        assert!(may_subscribe(&config(rows, true), rows) && may_subscribe(&config("**", true), rows));
        assert!(may_subscribe(&config(rows, true), "fiatlux/v3/lab/s/*/truth/row"));
        let policy = "fiatlux/v3/*/s/*/observation";
        assert!(!may_subscribe(&config(policy, true), rows) && may_subscribe(&config(policy, false), rows));
    }
}
