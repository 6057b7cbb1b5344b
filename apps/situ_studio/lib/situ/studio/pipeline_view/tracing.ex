defmodule Situ.Studio.PipelineView.Tracing do
  @moduledoc false
  # Traces one originating time through a running pipeline. The user chooses it next to a message or types it; the trace
  # is updated until the time has passed everywhere.
  use Situ.Live.Component

  alias Situ.Diagnostics.Trace
  alias Situ.Studio.PipelineView.Feed
  alias Situ.Studio.WholeNumber

  @doc """
  Traces a time given by the page: in ns, as ISO 8601, or as a clock time (UTC) on the day of `now`.
  """
  @spec of(Feed.t(), term(), Situ.Time.t()) :: {:ok, Trace.t()} | {:error, Situ.Error.t()}
  def of(feed, text, now) do
    with {:ok, time} <- time(text, now), do: Feed.trace(feed, time)
  end

  defp time(text, now) when is_binary(text) do
    text = String.trim(text)

    case WholeNumber.parse(text) do
      {:ok, time} -> {:ok, time}
      :error -> Situ.Time.parse(if text =~ ~r/^\d\d:\d\d:\d\d/, do: day(now) <> text, else: text)
    end
  end

  defp time(other, _now), do: Situ.Time.parse(inspect(other))

  defp day(now), do: now |> Situ.Time.to_iso8601() |> String.slice(0, 11)

  @doc "Updates a trace, unless its time has passed everywhere."
  @spec again(Feed.t(), Trace.t() | nil) :: Trace.t() | nil
  def again(_feed, nil), do: nil

  def again(feed, trace) do
    with false <- Enum.all?(trace.hops, &(&1.state == :passed)),
         {:ok, later} <- Feed.trace(feed, trace.time) do
      later
    else
      _ -> trace
    end
  end

  attr(:error, :any, required: true)

  @doc false
  def ask(assigns) do
    ~H"""
    <form id="trace-time" class="trace" phx-submit="trace">
      <label class="dim">Trace a time (UTC)
        <input name="time" autocomplete="off" spellcheck="false" placeholder="12:34:56.789"></label>
      <p :if={@error} class="hint" role="alert">{Exception.message(@error)}</p>
    </form>
    """
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
      [] -> "No message of this time is in flight: all have passed, or none has been sent."
      places -> places |> Enum.join(", ") |> sentence()
    end
  end

  # Capitalizes only the first letter, because the names of components must not change.
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
