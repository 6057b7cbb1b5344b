defmodule Situ.Livebook.StreamOutput do
  @moduledoc false
  # Draws the messages of a stream into a frame, one at a time.
  use GenServer, restart: :temporary
  alias Situ.{Message, Subscription}
  alias Situ.Studio.Preview

  def start_link(arg), do: GenServer.start_link(__MODULE__, arg)

  @impl true
  def init({frame, {target, opts}}) do
    {:ok, subscription} = Subscription.start_link(target, every: opts[:every] || 200, tag: :event)
    span_ns = (opts[:seconds] || 10) * 1_000_000_000
    {:ok, %{frame: frame, subscription: subscription, span_ns: span_ns, points: %{}}}
  end

  @impl true
  def handle_info({:situ, :event, %Message{} = message}, state) do
    {html, state} = draw(Preview.kind(message.data), message, state)
    Kino.Frame.render(state.frame, Kino.HTML.new(IO.iodata_to_binary(html)))
    Subscription.request_next(state.subscription)
    {:noreply, state}
  end

  # The last drawing stays.
  def handle_info({:situ, :event, :ended}, state), do: {:noreply, state}

  def handle_info({:situ, :event, error}, state) do
    Kino.Frame.render(state.frame, Kino.Text.new(Exception.message(error)))
    {:noreply, state}
  end

  defp draw(:signal, %{originating_time: time, data: data}, state) do
    points =
      for {name, value} <- Preview.list_numbers(data), reduce: state.points do
        points -> Map.update(points, name, [{time, value}], &[{time, value} | &1])
      end

    points =
      Map.new(points, fn {name, list} -> {name, keep_recent(list, time - state.span_ns)} end)

    series = for {name, list} <- points, do: {name, Enum.reverse(list)}
    {Preview.plot(series), %{state | points: points}}
  end

  defp draw(_kind, message, state), do: {Preview.render(message.data), state}

  defp keep_recent(points, from),
    do: points |> Enum.take_while(&(elem(&1, 0) >= from)) |> Enum.take(1_000)
end
