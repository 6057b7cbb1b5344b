defmodule Situ.Annotation.Spans do
  @moduledoc """
  Converts streams whose messages contain start and end times to annotation streams. Examples are spoken words,
  recognized objects and results of a service.

      heard                                      # utterances with from, to and text
      |> Situ.Annotation.Spans.annotate(&[{&1.from, &1.to, "Said", %{"Words" => &1.text}}], by: "Moonshine")

  The function returns the spans of a message, each as `{from, to, track, values}`. An annotation is emitted at its
  end time when the stream has reached it, or when the stream closes. Annotations of a track cannot overlap: a span
  that begins before the previous span of its track has ended is shortened to begin at that end. A span that ends
  before an annotation that was already emitted is discarded.

  The schema of the example is `Situ.Annotation.Schema.text("Words")`.
  """
  @shared [
    proposed: [type: :boolean, default: false, doc: "Whether the annotations are proposals."],
    by: [type: {:optional, :string}, doc: "The annotator."],
    name: [type: :string, default: "Spans", doc: "The component's name."]
  ]

  use Situ.Component,
    inputs: [in: :any],
    outputs: [out: {:list, Situ.Annotation}],
    options: [
      spans: [type: {:fun, 1}, required: true],
      proposed: [type: :boolean, default: false],
      by: [type: {:optional, :string}]
    ]

  alias Situ.Annotation

  @type span ::
          {from :: Situ.Time.t(), to :: Situ.Time.t(), track :: String.t(), values :: map()}

  defstruct [:spans, :by, :emitted, proposed: false, ends: %{}, ahead: []]

  @doc """
  Emits the spans in a stream's messages as annotations.

  #{Situ.Options.docs(@shared)}
  """
  @spec annotate(Situ.Stream.t(), (term() -> [span()]), keyword()) :: Situ.Stream.t()
  def annotate(stream, spans, opts \\ []) when is_function(spans, 1) do
    opts = Situ.Options.validate!(opts, @shared)
    own = [spans: spans, proposed: opts[:proposed], by: opts[:by], name: opts[:name]]
    Situ.via(stream, __MODULE__, own)
  end

  @impl true
  def init(opts),
    do: {:ok, %__MODULE__{spans: opts[:spans], by: opts[:by], proposed: opts[:proposed]}}

  @impl true
  def handle_message(:in, message, _context, state) do
    state = message.data |> state.spans.() |> Enum.reduce(state, &add_span/2)
    emit_due(state, message.originating_time)
  end

  @impl true
  def handle_closed(:in, _time, _context, state), do: emit_due(state, :infinity)

  defp add_span({from, to, track, values}, state) do
    from = max(from, Map.get(state.ends, track, from))

    if to < from or (state.emitted != nil and to <= state.emitted) do
      state
    else
      annotation = %Annotation{
        from: from,
        to: to,
        track: track,
        values: values,
        by: state.by,
        proposed?: state.proposed
      }

      %{state | ends: Map.put(state.ends, track, to), ahead: [annotation | state.ahead]}
    end
  end

  # `:infinity` sorts after every number.
  defp emit_due(state, now) do
    {due, ahead} = Enum.split_with(state.ahead, &(&1.to <= now))

    actions =
      due
      |> Enum.group_by(& &1.to)
      |> Enum.sort()
      |> Enum.map(fn {to, annotations} -> {:out, to, unique_per_track(annotations)} end)

    emitted = actions |> Enum.map(&elem(&1, 1)) |> List.last()
    {actions, %{state | ahead: ahead, emitted: emitted || state.emitted}}
  end

  # The list is newest first. Of two annotations of a track that end together, the earlier one is longer and is kept.
  defp unique_per_track(annotations) do
    annotations |> Enum.reverse() |> Enum.uniq_by(& &1.track) |> Enum.sort_by(& &1.track)
  end
end
