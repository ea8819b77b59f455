/* A grasp: open, look, approach from above, look again, descend, close, lift. */
#include "holdpoint_skill.h"
#include "interface.h"

/* params.toml. */
static struct {
    double pictures, approach_height_m, approach_speed_m_s, descend_speed_m_s, contact_speed_m_s, contact_stop_n;
    double grip_force_n, lift_height_m, lift_speed_m_s, retries, timeout_secs;
} p;

static enum { RISE, OPEN, LOOK, APPROACH, LOOK_AGAIN, DESCEND, TOUCH, CLOSE, LIFT, DONE, FAILED, ABORT, ROLLBACK, RISING } phase;
static uint32_t ticks;      /* in the phase */
static uint8_t failure;
static holdpoint_pose sent; /* where the tool was sent last */
/* Sums over the pictures of the object: position, and cosine and sine of half its heading. */
static double sum[5], pictures;
static int64_t sequence = -1;

static void go(int to)
{
    phase = to;
    ticks = 0;
    pictures = 0;
    for (int i = 0; i < 5; i++)
        sum[i] = 0;
}

static void move_to(int to, holdpoint_pose pose, double max_speed_m_s, holdpoint_command *command)
{
    sent = pose;
    command->kind = HOLDPOINT_TOOL_POSE;
    command->tool_pose.pose = pose;
    command->tool_pose.max_speed_m_s = max_speed_m_s;
    go(to);
}

static void grip(double width_m, double speed_m_s, holdpoint_command *command)
{
    command->kind = HOLDPOINT_GRIPPER;
    command->gripper.width_m = width_m;
    command->gripper.speed_m_s = speed_m_s;
    command->gripper.force_n = p.grip_force_n;
}

static holdpoint_pose risen(holdpoint_pose pose, double by_m)
{
    pose.position.z += by_m;
    return pose;
}

static double magnitude(double x, double y, double z)
{
    return __builtin_sqrt(x * x + y * y + z * z);
}

static void look(const holdpoint_estimate *object)
{
    if (!object || object->sequence == sequence)
        return;
    double c = object->pose.rotation.w, s = object->pose.rotation.z, root = 0.7071067811865476;
    /* The object is square: turned by quarters until it is within an eighth of a turn. */
    for (int i = 0; i < 4 && (c < 0 || __builtin_fabs(s) > 0.41421356237309503 * c); i++) {
        double turned = s > 0 ? c + s : c - s;
        s = root * (s > 0 ? s - c : s + c);
        c = root * turned;
    }
    double seen[5] = { object->pose.position.x, object->pose.position.y, object->pose.position.z, c, s };
    for (int i = 0; i < 5; i++)
        sum[i] += seen[i];
    sequence = object->sequence;
    pictures++;
}

/* The hand straight down at a height above the object, square to it. */
static holdpoint_pose above(double height_m)
{
    double length = magnitude(sum[3], sum[4], 0), n = pictures;
    return (holdpoint_pose){ { sum[0] / n, sum[1] / n, sum[2] / n + height_m }, { sum[3] / length, sum[4] / length, 0, 0 } };
}

/* Up, and once more from the start; or gives up. */
static void retry(const holdpoint_observation *seen, int signal, holdpoint_command *command)
{
    if (p.retries-- >= 1) {
        move_to(RISE, risen(seen->tool, p.approach_height_m), p.lift_speed_m_s, command);
        return;
    }
    failure = signal;
    command->kind = HOLDPOINT_STOP;
    go(FAILED);
}

static void tick(const holdpoint_observation *seen, holdpoint_command *command)
{
    const holdpoint_vector at = seen->tool.position, v = seen->tool_twist.linear, to = sent.position;
    look(holdpoint_named(seen, seen->object));
    double secs = (double)++ticks / HOLDPOINT_RATE_HZ;
    bool arrived = magnitude(v.x, v.y, v.z) < 0.02 && magnitude(at.x - to.x, at.y - to.y, at.z - to.z) < 0.004;
    bool holds = seen->gripper_width_m > 0.012 && seen->gripper_force_n > 1;
    double force_n = seen->wrist_force_n > seen->gripper_force_n ? seen->wrist_force_n : seen->gripper_force_n;
    if (phase < DONE && seen->tick > p.timeout_secs * HOLDPOINT_RATE_HZ) {
        failure = HOLDPOINT_TIMED_OUT;
        command->kind = HOLDPOINT_STOP;
        go(FAILED);
        return;
    }
    switch (phase) {
    case RISE:
        if (arrived || secs > 2)
            go(OPEN);
        break;
    case OPEN:
        if (seen->gripper_width_m > 0.07)
            go(LOOK);
        else if (secs > 2)
            retry(seen, HOLDPOINT_TOOL_UNAVAILABLE, command);
        else
            grip(0.08, 0.2, command);
        break;
    case LOOK:
        if (pictures >= p.pictures)
            move_to(APPROACH, above(p.approach_height_m), p.approach_speed_m_s, command);
        else if (secs > 1.5)
            retry(seen, HOLDPOINT_TARGET_NOT_FOUND, command);
        break;
    case APPROACH:
        if (arrived)
            go(LOOK_AGAIN);
        break;
    case LOOK_AGAIN:
        if (pictures >= p.pictures)
            move_to(DESCEND, above(0.006), p.descend_speed_m_s, command);
        else if (secs > 1.5)
            retry(seen, HOLDPOINT_TARGET_NOT_FOUND, command);
        break;
    case DESCEND: /* fast through the air, slow where the pads may come down on the object */
        if (at.z < to.z + 0.05)
            move_to(TOUCH, sent, p.contact_speed_m_s, command);
        break;
    case TOUCH:
        if (force_n > p.contact_stop_n) {
            retry(seen, HOLDPOINT_UNEXPECTED_CONTACT, command);
        } else if (arrived) {
            grip(0, 0.12, command);
            go(CLOSE);
        }
        break;
    case CLOSE:
        if (secs > 0.3 && holds && seen->gripper_force_n > 0.5 * p.grip_force_n)
            move_to(LIFT, risen(seen->tool, p.lift_height_m), p.lift_speed_m_s, command);
        else if (secs > 1.5)
            retry(seen, HOLDPOINT_GRASP_MISSED, command);
        break;
    case LIFT:
        if (secs > 0.1 && !holds)
            retry(seen, HOLDPOINT_OBJECT_SLIPPED, command);
        else if (arrived)
            go(DONE);
        break;
    case DONE:
        command->kind = HOLDPOINT_DONE;
        break;
    case FAILED:
        command->kind = HOLDPOINT_FAIL;
        command->failure = failure;
        break;
    case ABORT:
        command->kind = HOLDPOINT_STOP;
        break;
    case ROLLBACK: /* stop, rise, and say so */
        if (secs < 0.15)
            command->kind = HOLDPOINT_STOP;
        else
            move_to(RISING, risen(seen->tool, 0.1), p.lift_speed_m_s, command);
        break;
    case RISING:
        if (arrived || secs > 2)
            go(DONE);
        break;
    }
}

/* One command a tick. A skill that plans ahead answers more of them. */
uint32_t skill_step(const holdpoint_observation *seen, holdpoint_command *commands)
{
    tick(seen, commands);
    return 1;
}

void skill_enter(uint8_t hook)
{
    go(hook == HOLDPOINT_SAFE_ABORT ? ABORT : ROLLBACK);
}

holdpoint_text skill_start(uint64_t seed, holdpoint_parameters parameters)
{
    (void)seed;
    phase = OPEN;
#define READ(name) \
    if (!holdpoint_number(parameters, #name, &p.name)) \
        return HOLDPOINT_TEXT("params.toml has no number " #name)
    READ(pictures);
    READ(approach_height_m);
    READ(approach_speed_m_s);
    READ(descend_speed_m_s);
    READ(contact_speed_m_s);
    READ(contact_stop_n);
    READ(grip_force_n);
    READ(lift_height_m);
    READ(lift_speed_m_s);
    READ(retries);
    READ(timeout_secs);
    return (holdpoint_text){ 0, 0 };
}

holdpoint_text skill_describe(holdpoint_parameters parameters, holdpoint_description *description)
{
    description->task = HOLDPOINT_TEXT("grasp");
    description->interface = HOLDPOINT_TEXT(INTERFACE);
    return skill_start(0, parameters);
}
