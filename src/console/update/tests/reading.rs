//! Only a text that was on the screen is approved, and exactly this text is stored with the decision.

use super::*;

const SMALL: (u16, u16) = (80, 14);

fn opened(tier: u8) -> TestConsole {
    let mut console = TestConsole::new(tier);
    let mut now = snapshot(tier, 'e');
    now.prompts[0].untested = (1..20).map(|number| format!("what is number {number}")).collect();
    console.tell(MsgKind::Snapshot(Arc::new(now)));
    console.keys("a");
    console.press(KeyCode::Enter);
    console.now_ms += GUARD_MS;
    console
}

fn unread(console: &TestConsole) -> usize {
    let Some(Overlay::Approval(prompt)) = &console.model.input.overlay else { panic!("no prompt") };
    prompt.unread()
}

/// The answer, and the lines that it signs.
fn decision(effects: &[Effect]) -> (ApprovalDecision, Option<Vec<String>>) {
    let Some(Effect::Decide { decision, .. }) = effects.first() else { panic!("{effects:?}") };
    (decision.answer(), decision.question().map(|question| question.lines.clone()))
}

#[test]
fn approval_needs_every_line_shown_on_the_screen() {
    let mut console = opened(0);
    let all = unread(&console);
    assert!(!decides(&console.keys("Y")), "before the first frame");
    assert_eq!(console.block(), Some(DecisionObstacle::Unread));
    let mut left = all;
    for page in 0.. {
        console.draw(SMALL);
        let now = unread(&console);
        assert!(now < left, "page {page} shows something new");
        left = now;
        if left == 0 {
            break;
        }
        assert!(!decides(&console.keys("Y")), "{left} of {all} unread");
        assert_eq!(console.block(), Some(DecisionObstacle::Unread));
        console.press(KeyCode::PageDown);
    }
    let Some(Overlay::Approval(prompt)) = &console.model.input.overlay else { panic!("no prompt") };
    let text = prompt.text();
    let (answer, shown) = decision(&console.keys("Y"));
    assert_eq!((answer, shown), (ApprovalDecision::Approve, Some(text)));
}

/// Keys that come faster than frames scroll over lines that the operator cannot have seen.
#[test]
fn lines_scrolled_over_between_two_frames_are_unread() {
    let mut console = opened(0);
    console.draw(SMALL);
    (0..40).for_each(|_| drop(console.press(KeyCode::PageDown)));
    console.draw(SMALL);
    assert!(unread(&console) > 0);
    assert!(!decides(&console.keys("Y")));
}

#[test]
fn a_window_without_room_for_the_decision_shows_none_of_it() {
    let mut console = opened(0);
    let all = unread(&console);
    for size in [(80, 3), (20, 8), (1, 1), (0, 0), (80, 2)] {
        console.draw(size);
        assert_eq!(unread(&console), all, "{size:?}");
    }
}

#[test]
fn a_line_is_read_once_all_its_rows_were_there_at_one_width() {
    let mut console = opened(0);
    for width in (20..100).step_by(7) {
        console.draw((width, 16));
    }
    let before = unread(&console);
    // A text read at another width stays read.
    console.draw((120, 16));
    assert!(unread(&console) <= before);
    console.draw((120, 80));
    assert_eq!(unread(&console), 0);
}

#[test]
fn rejecting_needs_no_reading_and_signs_no_line_that_was_not_read() {
    for (size, is_read) in [(SMALL, false), ((120, 80), true)] {
        let mut console = opened(0);
        console.draw(size);
        assert_eq!(unread(&console) == 0, is_read);
        console.keys("N");
        console.keys("not now");
        console.press(KeyCode::Esc);
        let (answer, shown) = decision(&console.keys("N"));
        assert_eq!(answer, ApprovalDecision::Reject);
        assert_eq!(shown.is_some(), is_read, "{shown:?}");
    }
}

#[test]
fn a_question_read_again_is_unread() {
    let mut console = opened(0);
    console.draw((120, 80));
    assert_eq!(unread(&console), 0);
    console.keys("r");
    assert!(unread(&console) > 0);
}

#[test]
fn invisible_reason_counts_as_missing() {
    for unseen in ["\u{200b}", "\u{200d}\u{2060}", " \u{3164} ", "\u{ad}"] {
        let mut console = TestConsole::new(2);
        console.open_prompt();
        console.fill("aaaa", unseen);
        assert!(!decides(&console.keys("Y")), "{unseen:?}");
        assert_eq!(console.block(), Some(DecisionObstacle::Reason), "{unseen:?}");
        assert!(!decides(&console.keys("N")), "{unseen:?}");
    }
}

/// Regression: `give a reason (tab)` stood before `type the short id (tab)`, and while the cursor was in the reason.
#[test]
fn steps_to_a_decision_are_named_in_their_order_and_from_where_the_cursor_is() {
    use holdpoint_wording::console::approval_screen as wording;
    let mut console = TestConsole::new(2);
    console.open_prompt();
    let place = |console: &TestConsole, text: &str| consistency::screen(console, 120, 36).find(text);
    let short_id = place(&console, wording::SHORT_ID_MISSING);
    assert!(short_id.is_some() && short_id < place(&console, wording::REASON_MISSING));
    console.keys("N");
    assert_eq!(place(&console, wording::REASON_MISSING), None);
    for text in [wording::REASON_HERE, wording::REASON_BEFORE_KEY] {
        assert!(place(&console, text).is_some(), "{text}");
    }
    assert!(place(&console, wording::REASON_HERE) < place(&console, wording::TYPING));
}

/// After an answer from elsewhere, the prompt offers no key without an effect, and no key has one.
#[test]
fn closed_request_offers_only_to_leave_it() {
    let look = Look::new(Theme::builtin("mono").unwrap(), ColorDepth::Mono, Glyphs::Unicode);
    for (is_stale, protection) in
        [(false, Protection::None), (true, Protection::None), (false, Protection::Passphrase)]
    {
        let mut console = TestConsole::new(1);
        console.sit_with("ana", protection);
        console.open_prompt();
        console.fill("aaaa", "looks right");
        if is_stale {
            console.tell(MsgKind::Snapshot(Arc::new(snapshot(1, 'f'))));
        } else if protection == Protection::Passphrase {
            console.keys("Y");
            let Some(Overlay::Approval(prompt)) = &console.model.input.overlay else { panic!("it asks") };
            assert!(prompt.signing.is_some());
        }
        let mut closed = snapshot(1, 'e');
        closed.prompts.clear();
        console.tell(MsgKind::Snapshot(Arc::new(closed)));
        for keys in ["", "Y", "N", "r", "\t", "aaaa"] {
            for key in keys.chars() {
                let code = if key == '\t' { KeyCode::Tab } else { KeyCode::Char(key) };
                assert!(!decides(&console.press(code)), "{key:?}");
            }
            console.model.notice = None;
            let screen = crate::frame::text_of(&console.model, &look, 120, 36);
            assert!(screen.contains("CLOSED since") && screen.contains("esc leaves"), "{screen}");
            for offer in [
                "Sign]",
                "Y Sign",
                "Reject",
                "Later",
                "read it again",
                "short id",
                "Passphrase",
                "decide later",
                "reread",
            ] {
                assert!(!screen.contains(offer), "{offer:?} after {keys:?}: {screen}");
            }
        }
        // Where a passphrase was being typed, a separate key leaves it.
        console.now_ms += GUARD_MS;
        console.press(KeyCode::Enter);
        assert!(console.model.input.overlay.is_none());
        assert!(!console.model.notice.as_ref().is_some_and(|notice| notice.text.contains("it waits")));
    }
}
