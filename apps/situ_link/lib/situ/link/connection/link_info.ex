defmodule Situ.Link.Connection.LinkInfo do
  @moduledoc false
  # Builds the status of a link, which `Situ.Link.info/1` returns. Pure.
  alias Situ.Link.Connection.Channel
  alias Situ.Link.Wire.ClockEstimate

  @spec build_link_info(map()) :: map()
  def build_link_info(state) do
    now = state.opts.now.()

    %{
      connected?: state.socket != nil,
      connections: state.connections,
      error: state.error,
      bytes: state.bytes,
      offset: ClockEstimate.offset_at(state.clock, now),
      drift: state.clock.drift,
      uncertainty: ClockEstimate.uncertainty_at(state.clock, now),
      round_trip: state.clock.rtt,
      streams:
        for(
          {_, channel} <- state.channels,
          into: %{},
          do: {channel.name, Channel.channel_stats(channel)}
        )
    }
  end
end
