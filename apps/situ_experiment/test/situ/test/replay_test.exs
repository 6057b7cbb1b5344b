defmodule Situ.Test.ReplayTest do
  use ExUnit.Case, async: true
  import Situ.Dataset.Test.Study, only: [record: 3, ten: 1]
  import Situ.Test.Replay
  alias Situ.Store

  @moduletag :tmp_dir

  setup %{tmp_dir: root} do
    twice = for {time, n} <- ten(100), do: {time, n * 2.0}
    %{recording: record(root, "room", %{"Level" => ten(100), "Twice" => twice})}
  end

  defp times(factor) do
    fn _p, recording ->
      %{"Twice" => recording |> Store.stream("Level") |> Situ.map(&(&1 * factor), type: :float)}
    end
  end

  test "passes for equal streams, and for close ones within a tolerance", %{recording: recording} do
    assert assert_replays_like(recording, times(2.0)) == :ok

    assert assert_replays_like(Store.open!(recording), times(2.01), tolerances: %{"Twice" => 0.1}) ==
             :ok
  end

  test "names the stream and the first difference", %{recording: recording} do
    error =
      assert_raise(ExUnit.AssertionError, fn -> assert_replays_like(recording, times(3.0)) end)

    assert error.message =~ "Twice: message 2 at 1970-01-01T00:01:41"
    assert error.message =~ "is 3.0 instead of 2.0"
  end

  test "finds missing messages and streams", %{recording: recording} do
    build = fn _p, r ->
      %{"Twice" => r |> Store.stream("Level") |> Situ.filter(&(&1 < 5)) |> Situ.map(&(&1 * 2.0))}
    end

    error = assert_raise(ExUnit.AssertionError, fn -> assert_replays_like(recording, build) end)
    assert error.message =~ "message 6 is missing"

    build = fn _p, r -> %{"Trice" => Store.stream(r, "Level")} end
    error = assert_raise(ExUnit.AssertionError, fn -> assert_replays_like(recording, build) end)
    assert error.message =~ "Trice"
  end
end
