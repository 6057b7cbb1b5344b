defmodule Situ.Link.LinkMetricsTest do
  use ExUnit.Case, async: true
  alias Situ.Link.Connection.Channel
  alias Situ.Link.LinkMetrics

  @second 1_000_000_000

  defp link(changes) do
    stats = %{received: 10, lost: 1, under_way: 512, lag: 2 * @second}

    Map.merge(
      %{
        address: "situ://lab1",
        connected?: true,
        connections: 2,
        bytes: 4_096,
        round_trip: 3_000_000,
        streams: %{"imu" => stats}
      },
      Map.new(changes)
    )
  end

  test "writes the state of links and their streams" do
    assert LinkMetrics in Application.get_env(:situ_link, :metrics)
    text = Situ.Metrics.to_text(LinkMetrics.build_metrics([link([])]))
    assert text =~ ~s(situ_link_connected{address="situ://lab1"} 1\n)
    assert text =~ ~s(situ_link_round_trip_seconds{address="situ://lab1"} 0.003\n)
    assert text =~ ~s(situ_link_received_bytes_total{address="situ://lab1"} 4096\n)
    assert text =~ ~s(situ_link_lag_seconds{address="situ://lab1",stream="imu"} 2.0\n)
    assert text =~ ~s(situ_link_waiting_bytes{address="situ://lab1",stream="imu"} 512\n)
  end

  test "joins links to the same address, and leaves unknown values out" do
    lost =
      link(
        connected?: false,
        round_trip: nil,
        streams: %{"imu" => %{received: 0, lost: 0, under_way: 0, lag: nil}}
      )

    text = Situ.Metrics.to_text(LinkMetrics.build_metrics([link([]), lost]))
    assert text =~ ~s(situ_link_connected{address="situ://lab1"} 0\n)
    assert text =~ ~s(situ_link_received_messages_total{address="situ://lab1",stream="imu"} 10\n)
    refute Situ.Metrics.to_text(LinkMetrics.build_metrics([lost])) =~ "lag"
  end

  test "the lag is measured when a message is taken, and grows while messages wait" do
    request = %{
      name: "imu",
      from: :start,
      policy: nil,
      priority: 0,
      window: 1_000,
      times: :sender
    }

    channel = Channel.new(1, self(), request)
    assert Channel.measure_lag(channel, 5 * @second, false) == nil
    {:ok, channel} = Channel.accept_batch(channel, 100, 1 * @second, 1)
    channel = Channel.record_consumed(channel, 100, 1 * @second, 2 * @second)
    assert Channel.measure_lag(channel, 60 * @second, false) == 1 * @second
    assert Channel.measure_lag(channel, 60 * @second, true) == 59 * @second
    {:ok, channel} = Channel.accept_batch(channel, 100, 3 * @second, 1)
    assert Channel.measure_lag(channel, 60 * @second, false) == 59 * @second
  end
end
