defmodule Situ.Annotation.Segmenting do
  @moduledoc """
  Converts streams of states to annotation streams.

      voice                                    # booleans become one track
      |> Situ.Annotation.Segmenting.from_booleans(track: "P1", values: %{"Speech" => "speaks"})

      speakers                                 # maps %{"P1" => true, "P2" => false} become a track per key
      |> Situ.Annotation.Segmenting.from_keys(fn key, value -> value && %{"Speech" => key} end)

  An annotation begins with the first message for which its condition is true (for keys: the key exists and the
  function returns values). It ends at the first message for which the condition is false, and is emitted at that
  message's originating time. If the values change, the annotation ends and the next one starts at the same time. An
  annotation that is still open when the stream closes ends at the last message and is emitted then.
  """
  use Situ.Component,
    inputs: [in: :any],
    outputs: [out: {:list, Situ.Annotation}],
    options: [
      segments: [type: {:fun, 1}, required: true],
      proposed: [type: :boolean, default: false],
      by: [type: {:optional, :string}]
    ]

  alias Situ.Annotation

  @shared [
    proposed: [type: :boolean, default: false, doc: "Whether the annotations are proposals."],
    by: [type: {:optional, :string}, doc: "The annotator."],
    name: [type: :string, default: "Segments", doc: "The component's name."]
  ]
  @booleans [
              track: [type: :string, default: "Track", doc: "The track of all annotations."],
              values: [type: :map, default: %{}, doc: "The values of each annotation."]
            ] ++ @shared

  defstruct [:segments, :by, :last, :emitted, proposed: false, open: %{}]

  @doc """
  Emits an annotation for each interval in which a stream of booleans is true.

  #{Situ.Options.docs(@booleans)}
  """
  @spec from_booleans(Situ.Stream.t(), keyword()) :: Situ.Stream.t()
  def from_booleans(stream, opts \\ []) do
    opts = Situ.Options.validate!(opts, @booleans)
    {track, values} = {opts[:track], opts[:values]}
    add_component(stream, fn on? -> if on?, do: %{track => values}, else: %{} end, opts)
  end

  @doc """
  Emits annotations for the keys of a stream of maps, with a track per key that has the key's name. `fun.(key, value)`
  returns the values of the annotation, or `nil` (`false`) without an annotation.

  #{Situ.Options.docs(@shared)}
  """
  @spec from_keys(Situ.Stream.t(), (term(), term() -> map() | nil | false), keyword()) ::
          Situ.Stream.t()
  def from_keys(stream, fun, opts \\ []) when is_function(fun, 2) do
    opts = Situ.Options.validate!(opts, @shared)

    segments = fn map ->
      for {key, value} <- map, values = fun.(key, value), into: %{}, do: {track_name(key), values}
    end

    add_component(stream, segments, opts)
  end

  defp track_name(key) when is_binary(key), do: key
  defp track_name(key) when is_atom(key) or is_number(key), do: to_string(key)
  defp track_name(key), do: inspect(key)

  defp add_component(stream, segments, opts) do
    own = [segments: segments, proposed: opts[:proposed], by: opts[:by]]
    Situ.via(stream, __MODULE__, own ++ [name: opts[:name]])
  end

  @impl true
  def init(opts),
    do: {:ok, %__MODULE__{segments: opts[:segments], by: opts[:by], proposed: opts[:proposed]}}

  @impl true
  def handle_message(:in, message, _context, state) do
    now = state.segments.(message.data)
    time = message.originating_time

    {ended_segments, open_segments} =
      Enum.split_with(state.open, fn {track, {_, values}} -> now[track] != values end)

    new_segments =
      for {track, values} <- now,
          not List.keymember?(open_segments, track, 0),
          do: {track, {time, values}}

    emitted = if ended_segments == [], do: state.emitted, else: time

    {emit_segments(ended_segments, time, state),
     %{state | open: Map.new(open_segments ++ new_segments), last: time, emitted: emitted}}
  end

  @impl true
  def handle_closed(:in, _time, _context, state) do
    time =
      if state.emitted == state.last and state.last != nil, do: state.last + 1, else: state.last

    {emit_segments(Map.to_list(state.open), time, state), %{state | open: %{}}}
  end

  defp emit_segments([], _time, _state), do: []

  defp emit_segments(segments, time, state) do
    annotations =
      for {track, {from, values}} <- Enum.sort(segments) do
        %Annotation{
          from: from,
          to: time,
          track: track,
          values: values,
          by: state.by,
          proposed?: state.proposed
        }
      end

    [{:out, time, annotations}]
  end
end
