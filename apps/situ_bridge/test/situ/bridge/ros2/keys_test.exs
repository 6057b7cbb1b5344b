defmodule Situ.Bridge.Ros2.KeysTest do
  use ExUnit.Case, async: true
  alias Situ.Bridge.Ros2.Keys
  doctest Keys

  test "tokens are those of rmw_zenoh" do
    assert Keys.node(3, "abc", "eyes") == "@ros2_lv/3/abc/0/0/NN/%/%/eyes"

    assert Keys.token(:publisher, 0, "abc", "eyes", {"/a/b", "std_msgs/String", "RIHS01_x"}) ==
             "@ros2_lv/0/abc/0/1/MP/%/%/eyes/%a%b/std_msgs::msg::dds_::String_/RIHS01_x/::,10:,:,:,,"
  end

  test "attachments carry number, time and sender" do
    gid = :crypto.strong_rand_bytes(16)

    assert <<7::little-64, 5::little-64, 16, ^gid::binary>> =
             attachment = Keys.attachment(7, 5, gid)

    assert Keys.time(attachment) == 5
    assert Keys.time("short") == nil
    assert Keys.time(<<0::64, -1::little-64, 16>>) == nil
  end
end
