/* A robot's motion service in C, on Cyclone DDS 0.10 as Debian has it: it runs a mode until it is told to release it,
   and ends after it was asked for its mode once more. It knows nothing of Saltus. */
#include <stdio.h>
#include <stdlib.h>

#include "dds/dds.h"
#include "unitree_go.h"

int main(int count, char **arguments) {
  if (count < 2) return 1;
  dds_entity_t me = dds_create_participant((dds_domainid_t) atoi(arguments[1]), NULL, NULL);
  if (me < 0) return 1;
  dds_entity_t in = dds_create_reader(
      me, dds_create_topic(me, &unitree_api_msg_dds__Request__desc, "rt/api/motion_switcher/request", NULL, NULL),
      NULL, NULL);
  dds_entity_t out = dds_create_writer(
      me, dds_create_topic(me, &unitree_api_msg_dds__Response__desc, "rt/api/motion_switcher/response", NULL, NULL),
      NULL, NULL);
  dds_entity_t set = dds_create_waitset(me);
  dds_set_status_mask(in, DDS_DATA_AVAILABLE_STATUS);
  dds_waitset_attach(set, in, 0);
  void *samples[1] = {NULL};
  dds_sample_info_t infos[1];
  int released = 0, ended = 0;
  /* It gives up after 50 s without a request */
  for (int silent = 0; !ended && silent < 1000;) {
    if (dds_waitset_wait(set, NULL, 0, DDS_MSECS(50)) == 0) silent++;
    while (dds_take(in, samples, infos, 1, 1) > 0) {
      unitree_api_msg_dds__Request_ *request = samples[0];
      if (infos[0].valid_data) {
        unitree_api_msg_dds__Response_ response = {0};
        response.header.identity = request->header.identity;
        response.data = "";
        if (request->header.identity.api_id == 1003)
          released = 1;
        else if (request->header.identity.api_id == 1001) {
          response.data = released ? "{\"form\":\"0\",\"name\":\"\"}" : "{\"form\":\"0\",\"name\":\"mcf\"}";
          ended = released;
        } else
          response.header.status.code = 3203;
        if (dds_write(out, &response) < 0) return 2;
        silent = 0;
      }
      dds_return_loan(in, samples, 1);
    }
  }
  dds_sleepfor(DDS_MSECS(500)); /* the last answer is on its way */
  dds_delete(me);
  return ended ? 0 : 3;
}
