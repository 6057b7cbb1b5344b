defmodule Situ.Bridge.Ros2.KeysTest do
  use ExUnit.Case, async: true
  alias Situ.Bridge.Ros2.Keys
  doctest Keys

  test "writes the tokens of rmw_zenoh" do
    assert Keys.node_token(3, "abc", "eyes") == "@ros2_lv/3/abc/0/0/NN/%/%/eyes"

    assert Keys.endpoint_token(
             :publisher,
             0,
             "abc",
             "eyes",
             {"/a/b", "std_msgs/String", "RIHS01_x", nil}
           ) ==
             "@ros2_lv/0/abc/0/1/MP/%/%/eyes/%a%b/std_msgs::msg::dds_::String_/RIHS01_x/::,10:,:,:,,"
  end

  test "marks a latched topic, and distinguishes services" do
    about = {"/map", "nav_msgs/OccupancyGrid", "RIHS01_x", 3}
    assert Keys.endpoint_token(:publisher, 0, "abc", "eyes", about) =~ ~r"/RIHS01_x/:1:,3:,:,:,,$"

    # The example is from rmw_zenoh's design page.
    about = {"/add_two_ints", "example_interfaces/srv/AddTwoInts", "RIHS01_e1", nil}

    assert Keys.endpoint_token(:server, 2, "aac3178e", "add_two_ints_server", about) ==
             "@ros2_lv/2/aac3178e/0/1/SS/%/%/add_two_ints_server/%add_two_ints/" <>
               "example_interfaces::srv::dds_::AddTwoInts_/RIHS01_e1/::,10:,:,:,,"
  end

  test "replies with the number and the sender of the request" do
    gid = :crypto.strong_rand_bytes(16)

    assert Keys.reply_attachment(Keys.build_attachment(7, 5, gid), 9) ==
             {:ok, Keys.build_attachment(7, 9, gid)}

    assert Keys.reply_attachment("short", 9) == :error
  end

  test "attaches the number, the time and the sender" do
    gid = :crypto.strong_rand_bytes(16)

    assert <<7::little-64, 5::little-64, 16, ^gid::binary>> =
             attachment = Keys.build_attachment(7, 5, gid)

    assert Keys.parse_time(attachment) == 5
    assert Keys.parse_time("short") == nil
    assert Keys.parse_time(<<0::64, -1::little-64, 16>>) == nil
  end
end
