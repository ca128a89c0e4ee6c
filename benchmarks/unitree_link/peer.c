/* A robot's side of the low level in C, on Cyclone DDS 0.10 as Debian has it: each command whose checksum is right,
   bit by bit over the struct in memory, is answered by a state that repeats it. It knows nothing of Saltus. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "checksum.h"
#include "dds/dds.h"
#include "unitree_go.h"

int main(int count, char **arguments) {
  if (count < 3) return 1;
  dds_entity_t me = dds_create_participant((dds_domainid_t) atoi(arguments[1]), NULL, NULL);
  if (me < 0) return 1;
  long wanted = atol(arguments[2]), wrong = 0, answered = 0;
  dds_entity_t in = dds_create_reader(
      me, dds_create_topic(me, &unitree_go_msg_dds__LowCmd__desc, "rt/lowcmd", NULL, NULL), NULL, NULL);
  dds_entity_t out = dds_create_writer(
      me, dds_create_topic(me, &unitree_go_msg_dds__LowState__desc, "rt/lowstate", NULL, NULL), NULL, NULL);
  dds_entity_t set = dds_create_waitset(me);
  dds_set_status_mask(in, DDS_DATA_AVAILABLE_STATUS);
  dds_waitset_attach(set, in, 0);
  static unitree_go_msg_dds__LowState_ state;
  void *samples[1] = {NULL};
  dds_sample_info_t infos[1];
  /* It says its state again while nobody speaks, and gives up after 50 s */
  for (int silent = 0; answered + wrong < wanted && silent < 1000;) {
    if (dds_waitset_wait(set, NULL, 0, DDS_MSECS(50)) == 0) {
      silent++;
      state.crc = checksum(&state, sizeof state);
      if (dds_write(out, &state) < 0) return 2;
    }
    while (dds_take(in, samples, infos, 1, 1) > 0) {
      unitree_go_msg_dds__LowCmd_ *command = samples[0];
      if (infos[0].valid_data && checksum(command, sizeof *command) == command->crc) {
        silent = 0, answered++;
        for (int i = 0; i < 20; i++) {
          state.motor_state[i].mode = command->motor_cmd[i].mode;
          state.motor_state[i].q = command->motor_cmd[i].q;
          state.motor_state[i].dq = command->motor_cmd[i].dq;
          state.motor_state[i].tau_est = command->motor_cmd[i].tau;
        }
        state.tick += 2;
        state.crc = checksum(&state, sizeof state);
        if (dds_write(out, &state) < 0) return 2;
      } else if (infos[0].valid_data)
        wrong++;
      dds_return_loan(in, samples, 1);
    }
  }
  printf("%zu %zu %ld %ld\n", sizeof(unitree_go_msg_dds__LowCmd_), sizeof state, answered, wrong);
  dds_delete(me);
  return answered + wrong < wanted ? 3 : 0;
}
