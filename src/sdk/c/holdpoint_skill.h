/* A skill in C: the messages of holdpoint:skill@1.0.0 (wit/skill.wit), as they lie in a component's memory, and the four
 * functions that a skill defines. Compile holdpoint_skill.c along; it exports them under their names.
 *
 * Units are SI: metres, radians, newtons, seconds. Poses are in the world frame, z up, the robot's base at the origin. */
#ifndef HOLDPOINT_SKILL_H
#define HOLDPOINT_SKILL_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

/* Ticks per second. */
#define HOLDPOINT_RATE_HZ 240

typedef struct {
    const char *bytes; /* UTF-8, without a zero at the end */
    uint32_t length;
} holdpoint_text;

/* A text in a literal. */
#define HOLDPOINT_TEXT(literal) ((holdpoint_text){ (literal), sizeof(literal) - 1 })

/* One value per arm joint, base to tool: the first `count` count. */
typedef struct {
    uint8_t count;
    double j[8];
} holdpoint_joints;

typedef struct {
    double x, y, z;
} holdpoint_vector;

/* Of unit length. */
typedef struct {
    double x, y, z, w;
} holdpoint_quaternion;

typedef struct {
    holdpoint_vector position; /* m */
    holdpoint_quaternion rotation;
} holdpoint_pose;

typedef struct {
    holdpoint_vector linear;  /* m/s */
    holdpoint_vector angular; /* rad/s */
} holdpoint_twist;

/* Where the camera last saw something, and how long ago. */
typedef struct {
    holdpoint_pose pose; /* with noise and bias */
    uint32_t age_ticks;  /* since the picture was taken */
    uint32_t sequence;   /* counts the pictures: a new number is a new measurement */
} holdpoint_estimate;

typedef struct {
    bool seen; /* false when the picture was dropped; the rest then says nothing */
    holdpoint_estimate at;
} holdpoint_seen;

enum { HOLDPOINT_GRASP, HOLDPOINT_ALIGN, HOLDPOINT_PLACE };

/* What the guard did with the previous command. */
enum { HOLDPOINT_ALLOWED, HOLDPOINT_CLAMPED, HOLDPOINT_DENIED };

/* What a skill may see in one tick. */
typedef struct {
    uint64_t tick; /* since the task started */
    holdpoint_joints q;   /* rad */
    holdpoint_joints dq;  /* rad/s */
    holdpoint_joints tau; /* N m */
    holdpoint_pose tool;
    holdpoint_twist tool_twist;
    double gripper_width_m;
    double gripper_force_n; /* mean normal force on the pads */
    double wrist_force_n;   /* without the payload's weight */
    holdpoint_seen object;
    holdpoint_seen target;
    bool tool_available;
    uint8_t goal;  /* HOLDPOINT_GRASP, ... */
    uint8_t guard; /* HOLDPOINT_ALLOWED, ... */
} holdpoint_observation;

/* Why a skill gives up. */
enum {
    HOLDPOINT_TARGET_NOT_FOUND,
    HOLDPOINT_GRASP_MISSED,
    HOLDPOINT_OBJECT_SLIPPED,
    HOLDPOINT_UNEXPECTED_CONTACT,
    HOLDPOINT_ALIGNMENT_LOST,
    HOLDPOINT_PLACEMENT_MISSED,
    HOLDPOINT_TOOL_UNAVAILABLE,
    HOLDPOINT_INPUT_STALE,
    HOLDPOINT_TIMED_OUT
};

enum {
    HOLDPOINT_HOLD,      /* leave both channels as they are */
    HOLDPOINT_TOOL_POSE, /* channel arm: the tool in a straight line to a pose */
    HOLDPOINT_JOINTS,    /* channel arm: the joints to a configuration */
    HOLDPOINT_GRIPPER,   /* channel gripper: the pads to a distance */
    HOLDPOINT_STOP,      /* channel arm: stand still as fast as the servo allows */
    HOLDPOINT_DONE,      /* the skill believes it has finished */
    HOLDPOINT_FAIL       /* the skill gives up */
};

/* What a skill may ask for in one tick. A setpoint stays in force until it is replaced. */
typedef struct {
    uint8_t kind; /* HOLDPOINT_HOLD, ... */
    union {
        struct {
            holdpoint_pose pose;
            double max_speed_m_s;
        } tool_pose;
        struct {
            holdpoint_joints q;
            double max_speed_rad_s;
        } joints;
        struct {
            double width_m, speed_m_s, force_n;
        } gripper;
        uint8_t failure; /* HOLDPOINT_TARGET_NOT_FOUND, ... */
    };
} holdpoint_command;

/* Entry points beside the ordinary tick: a standstill in a safe pose; or to where the predecessor can take over, then done. */
enum { HOLDPOINT_SAFE_ABORT, HOLDPOINT_ROLLBACK };

enum { HOLDPOINT_NUMBER, HOLDPOINT_FLAG, HOLDPOINT_STRING };

/* A setting of the parameter file. Of nested tables the name is the dotted path. Its texts last as long as the call. */
typedef struct {
    holdpoint_text name;
    uint8_t kind; /* HOLDPOINT_NUMBER, ... */
    union {
        double number;
        bool flag;
        holdpoint_text text;
    };
} holdpoint_parameter;

typedef struct {
    const holdpoint_parameter *all;
    uint32_t count;
} holdpoint_parameters;

/* What a skill defines. A text that is returned is an error; one without bytes is none. */

/* What the code offers and needs: its primitive, and its interface as JSON (see `description` in the WIT). */
holdpoint_text skill_describe(holdpoint_parameters parameters, uint8_t *task, holdpoint_text *interface);
/* Begins the one task of this instance. */
holdpoint_text skill_start(uint64_t seed, holdpoint_parameters parameters);
/* One decision. The command is `hold` until it is set. */
void skill_tick(const holdpoint_observation *seen, holdpoint_command *command);
/* Turns to a hook: the following ticks are the hook's. */
void skill_enter(uint8_t hook);

/* Reads a number of the parameter file into `value`; false if it has none of that name. */
bool holdpoint_number(holdpoint_parameters parameters, const char *name, double *value);

#endif
