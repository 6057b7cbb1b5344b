defmodule Situ.Diagnostics.Trace do
  @moduledoc false
  # The route of one originating time through a running pipeline. `Situ.trace/2` documents the fields.
  alias Situ.Graph.Vertex
  alias Situ.Ports.Counters

  defstruct [:time, :now, hops: [], inside: []]

  @type passed :: Situ.Time.t() | :forgotten | nil
  @type hop :: %{
          from: String.t(),
          to: String.t(),
          state: :coming | :waiting | :passed,
          sent: passed(),
          taken: passed(),
          waited: Situ.Time.duration() | nil,
          queue: non_neg_integer()
        }
  @type t :: %__MODULE__{
          time: Situ.Time.t(),
          now: Situ.Time.t(),
          hops: [hop()],
          inside: [String.t()]
        }

  # `links` connect stages by id; `stages` hold their vertices.
  @spec new(Situ.Time.t(), Situ.Time.t(), map()) :: t()
  def new(time, now, %{links: links, counters: counters, stages: stages}) do
    hops =
      for {tag, link} <- Enum.sort_by(links, &elem(&1, 0)) do
        ref = Map.fetch!(counters, tag)

        {link,
         build_hop(link, stages, Counters.passage_times(ref, time), {now, queue_length(ref)})}
      end

    %__MODULE__{
      time: time,
      now: now,
      hops: Enum.map(hops, &elem(&1, 1)),
      inside:
        for({id, stage} <- Enum.sort(stages), held_inside?(id, stage, hops), do: last_path(stage))
    }
  end

  defp build_hop(link, stages, {sent, taken}, {now, queue}) do
    %{
      from: last_path(stages[link.from]),
      to: hd(stages[link.to].vertices).path,
      state: hop_state(sent, taken),
      sent: sent,
      taken: taken,
      waited: waiting_time(sent, taken, now),
      queue: queue
    }
  end

  defp hop_state(nil, _taken), do: :coming
  defp hop_state(_sent, nil), do: :waiting
  defp hop_state(_sent, _taken), do: :passed

  defp waiting_time(sent, nil, now) when is_integer(sent), do: max(now - sent, 0)

  defp waiting_time(sent, taken, _now) when is_integer(sent) and is_integer(taken),
    do: max(taken - sent, 0)

  defp waiting_time(_sent, _taken, _now), do: nil

  defp queue_length(ref) do
    {emitted, processed, dropped} = Counters.flow_counts(ref)
    max(emitted - processed - dropped, 0)
  end

  # True if an input has taken the message and no output has sent it.
  defp held_inside?(id, %{vertices: [head | _]}, hops) do
    into = for {%{to: ^id}, hop} <- hops, do: hop
    out_of = for {%{from: ^id}, hop} <- hops, do: hop

    not Vertex.source?(head) and into != [] and Enum.any?(into, &(&1.state == :passed)) and
      Enum.all?(out_of, &(&1.state == :coming))
  end

  # A process is shown under the name of its last component, whose output leaves the process.
  defp last_path(stage), do: List.last(stage.vertices).path

  @spec format(t()) :: String.t()
  def format(%__MODULE__{} = trace) do
    waiting = for hop <- trace.hops, hop.state == :waiting, do: "waits for #{hop.to}"
    inside = for path <- trace.inside, do: "in (or ended in) #{path}"
    places = if waiting ++ inside == [], do: ["nowhere yet"], else: waiting ++ inside
    lines = Enum.map(trace.hops, &format_hop(&1, trace))
    Enum.join(["#{trace.time}: " <> Enum.join(places, ", ") | lines], "\n")
  end

  defp format_hop(hop, trace) do
    waited =
      cond do
        hop.waited != nil -> " waited " <> Situ.Time.format_duration(hop.waited)
        hop.state == :passed -> " long ago"
        true -> ""
      end

    sent =
      if is_integer(hop.sent),
        do: " sent #{Situ.Time.format_duration(hop.sent - trace.time)} after its time",
        else: ""

    "  #{hop.from} -> #{hop.to}: #{hop.state}#{sent}#{waited}, #{hop.queue} in the queue"
  end
end
