/* Our side of the low level in C, on Cyclone DDS 0.10: sends a command every 2 ms and prints how long the answer took
   [us], -1 where none came within 100 ms. A fair rival for a program that does the same. */
#include <stdio.h>
#include <stdlib.h>
#include <time.h>

#include "checksum.h"
#include "dds/dds.h"
#include "unitree_go.h"

static int64_t now_ns(void) {
  struct timespec now;
  clock_gettime(CLOCK_MONOTONIC, &now);
  return now.tv_sec * 1000000000LL + now.tv_nsec;
}

int main(int count, char **arguments) {
  if (count < 3) return 1;
  dds_entity_t me = dds_create_participant((dds_domainid_t) atoi(arguments[1]), NULL, NULL);
  if (me < 0) return 1;
  dds_entity_t out = dds_create_writer(
      me, dds_create_topic(me, &unitree_go_msg_dds__LowCmd__desc, "rt/lowcmd", NULL, NULL), NULL, NULL);
  dds_entity_t in = dds_create_reader(
      me, dds_create_topic(me, &unitree_go_msg_dds__LowState__desc, "rt/lowstate", NULL, NULL), NULL, NULL);
  dds_entity_t set = dds_create_waitset(me);
  dds_set_status_mask(in, DDS_DATA_AVAILABLE_STATUS);
  dds_waitset_attach(set, in, 0);
  static unitree_go_msg_dds__LowCmd_ command = {.head = {0xFE, 0xEF}, .level_flag = 0xFF};
  void *samples[1] = {NULL};
  dds_sample_info_t infos[1];
  int64_t tick = -1;
  for (int i = 0; i < 200 && tick < 0; i++) { /* the peer says its state while nobody speaks */
    dds_waitset_wait(set, NULL, 0, DDS_MSECS(50));
    while (dds_take(in, samples, infos, 1, 1) > 0) {
      if (infos[0].valid_data) tick = ((unitree_go_msg_dds__LowState_ *) samples[0])->tick;
      dds_return_loan(in, samples, 1);
    }
  }
  if (tick < 0) return 2;
  dds_sleepfor(DDS_MSECS(500));
  int64_t due = now_ns();
  for (int i = 0; i < atoi(arguments[2]); i++, due += 2000000) {
    struct timespec at = {due / 1000000000LL, due % 1000000000LL};
    clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &at, NULL);
    int64_t begin = now_ns(), end = 0;
    command.motor_cmd[0].q = 0.001f * i;
    command.crc = checksum(&command, sizeof command);
    if (dds_write(out, &command) < 0) return 3;
    while (end == 0 && now_ns() - begin < 100000000LL) {
      dds_waitset_wait(set, NULL, 0, DDS_MSECS(100));
      while (dds_take(in, samples, infos, 1, 1) > 0) {
        unitree_go_msg_dds__LowState_ *state = samples[0];
        if (infos[0].valid_data && state->tick > tick && checksum(state, sizeof *state) == state->crc)
          tick = state->tick, end = now_ns();
        dds_return_loan(in, samples, 1);
      }
    }
    printf("%.1f\n", end ? (end - begin) / 1e3 : -1.0);
  }
  dds_delete(me);
  return 0;
}
