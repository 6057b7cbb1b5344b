defmodule Situ.Bridge.Ros2.SessionTest do
  use ExUnit.Case, async: true
  alias Situ.Bridge.Ros2.Session

  test "without its program it says how to get it" do
    # The program is no part of the ordinary build; where it was built there is nothing to tell.
    case Session.program() do
      {:ok, path} ->
        assert File.regular?(path)

      {:error, error} ->
        assert error.code == :no_zenoh_port
        assert error.fix =~ "bin/setup --with ros2"
    end
  end
end
