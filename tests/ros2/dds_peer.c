/* A program of ROS 2's world in C, on Cyclone DDS 0.10 as Debian has it: publishes a robot that stands on level ground,
   prints the heights that come back, and ends after some of them. It knows nothing of Saltus. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "dds/dds.h"
#include "ros.h"

#define T(package, name) package##_msg_dds__##name##_
#define DESCRIPTOR(package, name) &package##_msg_dds__##name##__desc

static dds_entity_t writer(dds_entity_t participant, const dds_topic_descriptor_t *type, const char *name) {
  dds_qos_t *qos = dds_create_qos();
  dds_qset_reliability(qos, DDS_RELIABILITY_RELIABLE, DDS_MSECS(100));
  dds_entity_t made = dds_create_writer(participant, dds_create_topic(participant, type, name, NULL, NULL), qos, NULL);
  dds_delete_qos(qos);
  return made;
}

int main(int count, char **arguments) {
  dds_entity_t node = dds_create_participant((dds_domainid_t) atoi(arguments[1]), NULL, NULL);
  if (node < 0 || count < 3) return 1;
  int wanted = atoi(arguments[2]);
  dds_entity_t info_out = writer(node, DESCRIPTOR(sensor_msgs, CameraInfo), "rt/camera/depth/camera_info");
  dds_entity_t image_out = writer(node, DESCRIPTOR(sensor_msgs, Image), "rt/camera/depth/image_rect_raw");
  dds_entity_t joints_out = writer(node, DESCRIPTOR(sensor_msgs, JointState), "rt/joint_states");
  dds_entity_t imu_out = writer(node, DESCRIPTOR(sensor_msgs, Imu), "rt/imu/data");
  dds_entity_t odom_out = writer(node, DESCRIPTOR(nav_msgs, Odometry), "rt/odom");
  dds_entity_t map_topic = dds_create_topic(node, DESCRIPTOR(grid_map_msgs, GridMap), "rt/saltus/elevation_map_raw", NULL, NULL);
  dds_entity_t map_in = dds_create_reader(node, map_topic, NULL, NULL);

  char *names[12] = {NAMES};
  double positions[12] = {POSITIONS};
  static float depth[HEIGHT * WIDTH];
  for (int i = 0; i < HEIGHT * WIDTH; i++) depth[i] = DEPTH_M;

  T(sensor_msgs, CameraInfo) info = {.height = HEIGHT, .width = WIDTH, .distortion_model = "plumb_bob"};
  info.k[0] = info.k[4] = FOCAL, info.k[2] = 0.5 * WIDTH - 0.5, info.k[5] = 0.5 * HEIGHT - 0.5, info.k[8] = 1.0;
  T(sensor_msgs, Image) image = {.height = HEIGHT, .width = WIDTH, .encoding = "32FC1", .step = 4 * WIDTH};
  image.data._length = image.data._maximum = sizeof depth, image.data._buffer = (uint8_t *) depth;
  T(sensor_msgs, JointState) joints = {0};
  joints.name._length = joints.name._maximum = 12, joints.name._buffer = names;
  joints.position._length = joints.position._maximum = 12, joints.position._buffer = positions;
  T(sensor_msgs, Imu) imu = {.orientation = {0.0, TURN_Y, 0.0, TURN_W}, .angular_velocity = {0.0, 0.0, 0.2}};
  T(nav_msgs, Odometry) odom = {.child_frame_id = "base_link"};
  odom.twist.twist.linear.x = VELOCITY;

  void *samples[1] = {NULL};
  dds_sample_info_t infos[1];
  for (int round = 0; round < 6000 && wanted > 0; round++) {
    struct timespec now;
    clock_gettime(CLOCK_REALTIME, &now);
    T(std_msgs, Header) head = {.stamp = {(int32_t) now.tv_sec, (uint32_t) now.tv_nsec}, .frame_id = "their_frame"};
    info.header = image.header = joints.header = imu.header = odom.header = head;
    if (dds_write(info_out, &info) < 0 || dds_write(image_out, &image) < 0 || dds_write(joints_out, &joints) < 0 ||
        dds_write(imu_out, &imu) < 0 || dds_write(odom_out, &odom) < 0)
      return 2;
    while (wanted > 0 && dds_take(map_in, samples, infos, 1, 1) > 0) {
      T(grid_map_msgs, GridMap) *map = samples[0];
      if (infos[0].valid_data && map->layers._length == 3 && map->data._length == 3) {
        printf("%s %s %s", map->header.frame_id, map->layers._buffer[0], map->layers._buffer[1]);
        for (uint32_t layer = 0; layer < 2; layer++)
          for (uint32_t i = 0; i < map->data._buffer[layer].data._length; i++)
            printf(" %.9g", map->data._buffer[layer].data._buffer[i]);
        printf("\n");
        fflush(stdout);
        wanted--;
      }
      dds_return_loan(map_in, samples, 1);
    }
    dds_sleepfor(DDS_MSECS(10));
  }
  dds_delete(node);
  return wanted > 0 ? 3 : 0;
}
