defmodule Situ.Bridge.Ros2.ZenohTest do
  use ExUnit.Case, async: true
  alias Situ.Bridge.Ros2.Zenoh
  doctest Zenoh

  test "without its program it says how to get it" do
    # The program is no part of the ordinary build; where it was built there is nothing to tell.
    case Zenoh.program() do
      {:ok, path} ->
        assert File.regular?(path)

      {:error, error} ->
        assert error.code == :no_zenoh_port
        assert error.fix =~ "bin/setup --with ros2"
    end
  end

  test "its frames are read, and what is none is left" do
    assert Zenoh.read(<<2, 7::32, 3::16, "key", 2::16, "at", "payload">>) ==
             {:sample, 7, "key", "at", "payload"}

    assert Zenoh.read(<<5, 7::32, 9::32, 2::16, "at", "ask">>) == {:asked, 7, 9, "at", "ask"}
    assert Zenoh.read(<<6, 7::32, 0::16>>) == {:answer, 7, "", ""}
    assert Zenoh.read(<<7, 7::32, "no">>) == {:refusal, 7, "no"}
    assert Zenoh.read(<<8, 7::32>>) == {:answered, 7}
    assert Zenoh.read(<<255, 7::32, "why">>) == {:trouble, 7, "why"}

    for frame <- ["", <<2, 7::32, 9::16, "key">>, <<5, 7::32>>, <<77, 7::32>>],
        do: assert(Zenoh.read(frame) == :unknown)
  end
end
