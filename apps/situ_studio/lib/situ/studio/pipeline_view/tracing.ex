defmodule Situ.Studio.PipelineView.Tracing do
  @moduledoc false
  # The way of one originating time through a running pipeline: asked for beside a message, or typed; followed until it
  # has passed everywhere.
  use Situ.Live.Component

  alias Situ.Diagnostics.Trace
  alias Situ.Studio.PipelineView.Feed
  alias Situ.Studio.WholeNumber

  @doc "The trace of a time as the page gives it, in ns; `nil` where it is none, or where nothing runs any more."
  @spec of(Feed.t(), term()) :: Trace.t() | nil
  def of(feed, text) do
    with {:ok, time} <- WholeNumber.parse(text),
         {:ok, trace} <- Feed.trace(feed, time) do
      trace
    else
      _ -> nil
    end
  end

  @doc "The same a moment later, unless all is known."
  @spec again(Feed.t(), Trace.t() | nil) :: Trace.t() | nil
  def again(_feed, nil), do: nil

  def again(feed, trace) do
    if Enum.all?(trace.hops, &(&1.state == :passed)),
      do: trace,
      else: of(feed, Integer.to_string(trace.time)) || trace
  end

  attr(:trace, :any, required: true)

  @doc false
  def box(assigns) do
    ~H"""
    <section class="trace" id="trace" aria-label="Trace of one time">
      <h2>Trace of {clock(@trace.time)}
        <button class="mini" type="button" phx-click="trace_close" aria-label="Close the trace">×</button></h2>
      <p class="where-now">{place(@trace)}</p>
      <ol class="hops">
        <li :for={hop <- @trace.hops} :key={hop.from <> "→" <> hop.to} class={Atom.to_string(hop.state)}>
          <span>{hop.from} → {hop.to}</span><b>{told(hop)}</b>
        </li>
      </ol>
    </section>
    """
  end

  defp place(trace) do
    waiting = for hop <- trace.hops, hop.state == :waiting, do: "waits for #{hop.to}"
    inside = for path <- trace.inside, do: "in (or ended in) #{path}"

    case waiting ++ inside do
      [] -> "Nothing of this time is on its way: it has passed, or has not begun."
      places -> places |> Enum.join(", ") |> sentence()
    end
  end

  # Names of components keep their letters as they are.
  defp sentence(<<first::utf8, rest::binary>>), do: String.upcase(<<first::utf8>>) <> rest

  defp told(%{state: :coming}), do: "not sent yet"
  defp told(%{state: :waiting, waited: nil, queue: n}), do: "waits, #{n} in the queue"

  defp told(%{state: :waiting, waited: waited, queue: n}),
    do: "waits for #{Situ.Time.format_duration(waited)}, #{n} in the queue"

  defp told(%{state: :passed, waited: nil}), do: "passed, long ago"

  defp told(%{state: :passed, waited: waited}),
    do: "passed after #{Situ.Time.format_duration(waited)}"

  defp clock(ns), do: ns |> Situ.Time.to_iso8601() |> String.slice(11, 12)
end
