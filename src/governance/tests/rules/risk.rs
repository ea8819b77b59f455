//! The risk class: what each change gives alone, and that an author's word never lowers it.

use holdpoint_governance::manifest::BundleSource;
use holdpoint_governance::manifest::{Manifest, RelativePath};
use holdpoint_governance::mode::{Authority, Channel, CommandKind, Sensor, Tool, ZoneName};
use holdpoint_governance::risk::{RiskCause, RiskInput, classify};
use holdpoint_governance::submission::Risk;
use proptest::prelude::*;

fn manifest() -> Manifest {
    let text = include_str!("../../../../manifests/grasp/1.0.0/manifest.toml");
    Manifest::parse("manifest.toml", text).unwrap()
}

fn input<'a>(candidate: &'a Manifest, active: Option<&'a Manifest>) -> RiskInput<'a> {
    RiskInput { candidate, active, same_code: true, author_known: true, estimated: Risk::Low }
}

fn component(name: &str) -> BundleSource {
    BundleSource::Wasm(RelativePath::try_from(name.to_owned()).unwrap())
}

#[test]
fn every_single_change_gives_its_risk_class() {
    type ManifestChange = fn(&mut Manifest);
    let table: [(RiskCause, Risk, ManifestChange); 10] = [
        (RiskCause::MoreZones, Risk::High, |m| {
            m.permissions.zones.extend(ZoneName::SHIPPED);
        }),
        (RiskCause::MoreAuthority, Risk::High, |m| m.permissions.authority = Authority::try_from(3).unwrap()),
        (RiskCause::MorePermissions, Risk::Medium, |m| {
            m.permissions.channels.extend(Channel::ALL);
        }),
        (RiskCause::MorePermissions, Risk::Medium, |m| {
            m.permissions.commands.extend(CommandKind::ALL);
        }),
        (RiskCause::MorePermissions, Risk::Medium, |m| {
            m.permissions.sensors.extend(Sensor::ALL);
        }),
        (RiskCause::MorePermissions, Risk::Medium, |m| {
            m.permissions.tools.extend(Tool::ALL);
        }),
        (RiskCause::MorePermissions, Risk::Medium, |m| {
            m.deployment.imports.insert("wasi:clocks".to_owned());
        }),
        (RiskCause::MoreSpeed, Risk::Medium, |m| m.permissions.max_speed_m_s += 0.01),
        (RiskCause::MoreSpeed, Risk::Medium, |m| m.permissions.max_speed_m_s = f64::NAN),
        (RiskCause::MoreForce, Risk::Medium, |m| m.permissions.max_force_n += 0.1),
    ];
    let mut active = manifest();
    // Room to ask for more.
    active.permissions.tools.clear();
    active.permissions.channels.pop_last();
    active.permissions.commands.pop_last();
    active.permissions.sensors.pop_last();
    active.permissions.zones.pop_last();
    active.permissions.authority = Authority::try_from(0).unwrap();
    let found = classify(&input(&active, Some(&active)));
    assert_eq!((found.class, found.causes.len()), (Risk::Low, 0));
    for (cause, class, change) in table {
        let mut candidate = active.clone();
        change(&mut candidate);
        let found = classify(&input(&candidate, Some(&active)));
        assert_eq!((found.class, &found.causes), (class, &[cause].into()), "{cause}");
        // The other way round it asks for less.
        if candidate.permissions.max_speed_m_s.is_finite() {
            assert_eq!(classify(&input(&active, Some(&candidate))).class, Risk::Low, "{cause}");
        }
    }
}

#[test]
fn new_code_and_new_authors_raise_the_risk() {
    let native = manifest();
    let mut wasm = native.clone();
    wasm.deployment.bundle = component("grasp.wasm");
    let class = |input: RiskInput<'_>| {
        let found = classify(&input);
        (found.class, found.causes.into_iter().collect::<Vec<_>>())
    };
    use RiskCause::{BundleForm, Component, Estimated, FirstOfAuthor, NewCode, NothingActive};
    assert_eq!(
        class(RiskInput { same_code: false, ..input(&wasm, Some(&native)) }),
        (Risk::High, vec![Component, NewCode, BundleForm])
    );
    // A component is high, also with the same bytes.
    assert_eq!(class(input(&wasm, Some(&wasm))), (Risk::High, vec![Component]));
    // The rollback target with compiled-in code is another form, and other code.
    assert_eq!(
        class(RiskInput { same_code: false, ..input(&native, Some(&wasm)) }),
        (Risk::High, vec![NewCode, BundleForm])
    );
    assert_eq!(class(input(&native, None)), (Risk::High, vec![NothingActive]));
    let unknown = RiskInput { author_known: false, ..input(&native, Some(&native)) };
    assert_eq!(class(unknown), (Risk::Medium, vec![FirstOfAuthor]));
    // An estimate raises.
    for (estimated, expected) in
        [(Risk::Low, Risk::Medium), (Risk::Medium, Risk::Medium), (Risk::High, Risk::High)]
    {
        let found = class(RiskInput { estimated, ..unknown });
        assert_eq!((found.0, found.1.contains(&Estimated)), (expected, expected == Risk::High));
    }
}

proptest! {
    /// Whatever changed: a higher estimate never gives a lower class, and no estimate one below what the change gives.
    #[test]
    fn estimated_risk_only_raises_the_class(same_code: bool, author_known: bool, faster in -1.0..1.0_f64, harder in -1.0..1.0_f64) {
        let active = manifest();
        let mut candidate = active.clone();
        candidate.permissions.max_speed_m_s += faster;
        candidate.permissions.max_force_n += harder;
        let class = |estimated| {
            classify(&RiskInput { candidate: &candidate, active: Some(&active), same_code, author_known, estimated }).class
        };
        let floor = class(Risk::Low);
        for estimated in Risk::ALL {
            prop_assert_eq!(class(estimated), floor.max(estimated));
        }
    }
}
