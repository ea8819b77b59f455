//! The names of the system's users.

use std::fs::File;
use std::io::Read as _;

/// The most bytes read of the list of users.
const USERS_BYTES_MAX: u64 = 1 << 20;

/// The name of a user, as `/etc/passwd` lists it; absent for a user of another source.
#[must_use]
pub fn user_name(uid: u32) -> Option<String> {
    let mut users = String::new();
    let read =
        File::open("/etc/passwd").and_then(|file| file.take(USERS_BYTES_MAX).read_to_string(&mut users));
    read.ok().and_then(|_| name_of(&users, uid))
}

/// A user for a message: by name, or by number.
#[must_use]
pub fn described_user(uid: u32) -> String {
    user_name(uid).unwrap_or_else(|| format!("number {uid}"))
}

/// The first user with this number in a list in the format of `/etc/passwd` (passwd(5)).
fn name_of(users: &str, uid: u32) -> Option<String> {
    users.lines().find_map(|line| {
        let mut fields = line.split(':');
        let (name, number) = (fields.next()?, fields.nth(1)?);
        (number.parse() == Ok(uid) && !name.is_empty()).then(|| name.to_owned())
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_system_names_its_users() {
        let users = "root:x:0:0::/root:/bin/sh\nbad\nana:x:1000:1000::/home/ana:/bin/sh\n";
        assert_eq!(name_of(users, 1000).as_deref(), Some("ana"));
        assert_eq!(name_of(users, 0).as_deref(), Some("root"));
        assert_eq!(name_of(users, 7), None);
        assert_eq!(described_user(u32::MAX - 1), format!("number {}", u32::MAX - 1));
    }
}
