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
          do: {channel.name, describe_channel(channel, state)}
        )
    }
  end

  # A stream that has ended does not fall behind.
  defp describe_channel(channel, state) do
    waiting? = state.socket == nil and not channel.ended?
    lag = Channel.measure_lag(channel, sender_time(state), waiting?)
    Map.put(Channel.channel_stats(channel), :lag, lag)
  end

  @doc "Returns the current time of the sender's clock, as far as it is known."
  @spec sender_time(map()) :: Situ.Time.t()
  def sender_time(state) do
    now = state.opts.now.()
    now + ClockEstimate.offset_at(state.clock, now)
  end
end
