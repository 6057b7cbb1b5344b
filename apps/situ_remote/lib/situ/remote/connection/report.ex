defmodule Situ.Remote.Connection.Report do
  @moduledoc false
  # The status of a link, as returned by `Situ.Remote.info/1`. Pure.
  alias Situ.Remote.Connection.Channel
  alias Situ.Remote.Link.ClockEstimate

  @spec of(map()) :: map()
  def of(state) do
    now = state.opts.now.()

    %{
      connected?: state.socket != nil,
      connections: state.connected,
      error: state.error,
      bytes: state.received,
      offset: ClockEstimate.offset(state.clock, now),
      drift: state.clock.drift,
      uncertainty: ClockEstimate.uncertainty(state.clock, now),
      round_trip: state.clock.rtt,
      streams:
        for({_, channel} <- state.channels, into: %{}, do: {channel.name, Channel.info(channel)})
    }
  end
end
