defmodule Situ.TapTest do
  use ExUnit.Case, async: true

  alias Situ.Pipeline

  @moduletag :capture_log

  describe "the end message of Situ.Tap" do
    defp tapped(fun) do
      me = self()

      {:ok, p} =
        Pipeline.start(fn p ->
          {stream, tap} =
            p |> Situ.event_source(&send(me, {:post, &1})) |> Situ.map(fun) |> Situ.Tap.new()

          send(me, {:tap, tap})
          Situ.each(stream, & &1)
        end)

      assert_receive {:tap, tap}
      :ok = Situ.Tap.subscribe(tap)
      assert_receive {:post, post}
      {p, tap, post}
    end

    test "reports when the stream closed" do
      {p, tap, post} = tapped(& &1)
      post.(1)
      assert_receive {:situ_tap, ^tap, %{data: 1, originating_time: time}}
      assert {:ok, report} = Pipeline.stop(p)
      assert_received {:situ_tap_end, ^tap, {:closed, closed}}
      assert closed >= time and closed == report.final_time
      refute_received {:situ_tap_end, _, _}
    end

    test "reports why the pipeline failed" do
      {p, tap, post} = tapped(fn v -> if v == 2, do: raise("two"), else: v end)
      for v <- 1..2, do: post.(v)
      assert {:error, %{code: :component_failed}} = Pipeline.await(p)
      assert_received {:situ_tap_end, ^tap, %Situ.Error{code: :component_failed}}
    end

    test "arrives even if the pipeline is killed" do
      {p, tap, _post} = tapped(& &1)
      Process.exit(p, :kill)
      assert_receive {:situ_tap_end, ^tap, %Situ.Error{code: :crashed}}
    end
  end
end
