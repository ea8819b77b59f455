//! The names of the system's users and groups.

use std::fs::File;
use std::io::Read as _;

/// The most bytes read of the list of users or groups.
const LIST_BYTES_MAX: u64 = 1 << 20;

/// The list of users, as the system's file has it; users of other sources are missing.
const USERS: &str = "/etc/passwd";

/// The name of a user, as `/etc/passwd` lists it; absent for a user of another source.
#[must_use]
pub fn user_name(uid: u32) -> Option<String> {
    name_of(&read_list(USERS)?, uid)
}

/// The number of a user of this name in `/etc/passwd`; absent for a user of another source.
#[must_use]
pub fn user_number(name: &str) -> Option<u32> {
    number_of(&read_list(USERS)?, name)
}

/// A group for a message: by name, or by number.
#[must_use]
pub fn described_group(gid: u32) -> String {
    // group(5) has the name and the number in the places of passwd(5).
    read_list("/etc/group").and_then(|groups| name_of(&groups, gid)).unwrap_or_else(|| gid.to_string())
}

fn read_list(path: &str) -> Option<String> {
    let mut list = String::new();
    File::open(path).and_then(|file| file.take(LIST_BYTES_MAX).read_to_string(&mut list)).ok()?;
    Some(list)
}

/// A user for a message: by name, or by number.
#[must_use]
pub fn described_user(uid: u32) -> String {
    user_name(uid).unwrap_or_else(|| format!("number {uid}"))
}

/// The first name with this number in a list in the format of passwd(5).
fn name_of(list: &str, number: u32) -> Option<String> {
    entries(list).find_map(|(name, found)| (found == number).then(|| name.to_owned()))
}

/// The number of the first entry with this name.
fn number_of(list: &str, name: &str) -> Option<u32> {
    entries(list).find_map(|(found, number)| (found == name).then_some(number))
}

/// The names of a list with their numbers.
fn entries(list: &str) -> impl Iterator<Item = (&str, u32)> {
    list.lines().filter_map(|line| {
        let mut fields = line.split(':');
        let (name, number) = (fields.next()?, fields.nth(1)?);
        let number = number.parse::<u32>().ok()?;
        (!name.is_empty()).then_some((name, number))
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
        assert_eq!((number_of(users, "ana"), number_of(users, "bad")), (Some(1000), None));
        assert_eq!(name_of("root:x:0:\nseats:x:61001:ana,ben\n", 61_001).as_deref(), Some("seats"));
        assert_eq!(described_user(u32::MAX - 1), format!("number {}", u32::MAX - 1));
    }
}
