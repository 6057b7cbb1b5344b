defmodule Situ.Bridge.Ros2.ZenohTest do
  use ExUnit.Case, async: true
  alias Situ.Bridge.Ros2.Zenoh
  doctest Zenoh

  test "says how to get its program if it is missing" do
    # The ordinary build does not include the program, so the error is tested only where it is
    # missing.
    case Zenoh.find_program() do
      {:ok, path} ->
        assert File.regular?(path)

      {:error, error} ->
        assert error.code == :no_zenoh_port
        assert error.fix =~ "bin/setup --with ros2"
    end
  end

  test "reads frames, and ignores unknown ones" do
    assert Zenoh.parse_frame(<<2, 7::32, 3::16, "key", 2::16, "at", "payload">>) ==
             {:sample, 7, "key", "at", "payload"}

    assert Zenoh.parse_frame(<<5, 7::32, 9::32, 2::16, "at", "ask">>) ==
             {:request, 7, 9, "at", "ask"}

    assert Zenoh.parse_frame(<<6, 7::32, 0::16>>) == {:answer, 7, "", ""}
    assert Zenoh.parse_frame(<<7, 7::32, "no">>) == {:refusal, 7, "no"}
    assert Zenoh.parse_frame(<<8, 7::32>>) == {:query_end, 7}
    assert Zenoh.parse_frame(<<255, 7::32, "why">>) == {:trouble, 7, "why"}

    for frame <- ["", <<2, 7::32, 9::16, "key">>, <<5, 7::32>>, <<77, 7::32>>],
        do: assert(Zenoh.parse_frame(frame) == :unknown)
  end
end
