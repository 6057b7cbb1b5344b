defmodule Situ.Live.Demo.Frames do
  @moduledoc false
  # Frames made on demand: as many as there are credits, until params["n"].
  @behaviour Situ.Live.DataSocket

  @impl true
  def connect(_request, _arg), do: {:ok, %{}}

  @impl true
  def handle_open(channel, %{"n" => n}, state), do: {:ok, Map.put(state, channel, {0, n})}
  def handle_open(_channel, params, state), do: {:error, "no n in #{inspect(params)}", state}

  @impl true
  def handle_credit(channel, credits, state) do
    {done, n} = Map.fetch!(state, channel)
    upto = min(done + credits, n)

    frames =
      for i <- (done + 1)..upto//1 do
        %{channel: channel, kind: 7, time: i * 1000, data: <<i / 2::float-little-32>>}
      end

    {:push, frames, Map.put(state, channel, {upto, n})}
  end

  @impl true
  def handle_message(channel, %{"sum" => true}, state) do
    {done, _} = Map.fetch!(state, channel)
    {:reply, channel, Enum.sum(1..done), state}
  end

  def handle_message(channel, %{"burst" => n}, state) do
    frames = for i <- 1..n, do: %{channel: channel, kind: 8, time: i, data: <<i::32>>}
    {:push, frames, state}
  end

  @impl true
  def handle_close(channel, state), do: {:ok, Map.delete(state, channel)}
end
