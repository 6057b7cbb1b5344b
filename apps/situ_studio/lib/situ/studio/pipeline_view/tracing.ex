defmodule Situ.Studio.PipelineView.Tracing do
  @moduledoc false
  # Traces one originating time through a running pipeline. The user chooses it next to a message or types it; the trace
  # is updated until the time has passed everywhere.
  use Situ.Live.Component

  alias Situ.Diagnostics.Trace
  alias Situ.Studio.PipelineView.Feed
  alias Situ.Studio.Int64

  @doc """
  Traces a time given by the page: in ns, as ISO 8601, or as a clock time (UTC) on the day of `now`.
  """
  @spec trace_text(Feed.t(), term(), Situ.Time.t()) :: {:ok, Trace.t()} | {:error, Situ.Error.t()}
  def trace_text(feed, text, now) do
    with {:ok, time} <- parse_time(text, now), do: Feed.fetch_trace(feed, time)
  end

  defp parse_time(text, now) when is_binary(text) do
    text = String.trim(text)

    case Int64.parse(text) do
      {:ok, time} ->
        {:ok, time}

      :error ->
        Situ.Time.parse(if text =~ ~r/^\d\d:\d\d:\d\d/, do: day_prefix(now) <> text, else: text)
    end
  end

  defp parse_time(other, _now), do: Situ.Time.parse(inspect(other))

  defp day_prefix(now), do: now |> Situ.Time.to_iso8601() |> String.slice(0, 11)

  @doc "Updates a trace, unless its time has passed everywhere."
  @spec update_trace(Feed.t(), Trace.t() | nil) :: Trace.t() | nil
  def update_trace(_feed, nil), do: nil

  def update_trace(feed, trace) do
    with false <- Enum.all?(trace.hops, &(&1.state == :passed)),
         {:ok, later} <- Feed.fetch_trace(feed, trace.time) do
      later
    else
      _ -> trace
    end
  end

  attr(:error, :any, required: true)

  @doc false
  def trace_form(assigns) do
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
  def trace_panel(assigns) do
    ~H"""
    <section class="trace" id="trace" aria-label="Trace of one time">
      <h2>Trace of {format_clock(@trace.time)}
        <button class="mini" type="button" phx-click="trace_close" aria-label="Close the trace">×</button></h2>
      <p class="where-now">{describe_position(@trace)}</p>
      <ol class="hops">
        <li :for={hop <- @trace.hops} :key={hop.from <> "→" <> hop.to} class={Atom.to_string(hop.state)}>
          <span>{hop.from} → {hop.to}</span><b>{hop_status(hop)}</b>
        </li>
      </ol>
    </section>
    """
  end

  defp describe_position(trace) do
    waiting = for hop <- trace.hops, hop.state == :waiting, do: "waits for #{hop.to}"
    inside = for path <- trace.inside, do: "in (or ended in) #{path}"

    case waiting ++ inside do
      [] -> "No message of this time is in flight: all have passed, or none has been sent."
      places -> places |> Enum.join(", ") |> capitalize_first()
    end
  end

  # Capitalizes only the first letter, because the names of components must not change.
  defp capitalize_first(<<first::utf8, rest::binary>>), do: String.upcase(<<first::utf8>>) <> rest

  defp hop_status(%{state: :coming}), do: "not sent yet"
  defp hop_status(%{state: :waiting, waited: nil, queue: n}), do: "waits, #{n} in the queue"

  defp hop_status(%{state: :waiting, waited: waited, queue: n}),
    do: "waits for #{Situ.Time.format_duration(waited)}, #{n} in the queue"

  defp hop_status(%{state: :passed, waited: nil}), do: "passed, long ago"

  defp hop_status(%{state: :passed, waited: waited}),
    do: "passed after #{Situ.Time.format_duration(waited)}"

  defp format_clock(ns), do: ns |> Situ.Time.to_iso8601() |> String.slice(11, 12)
end
