defmodule Situ.Annotation do
  @moduledoc """
  Represents a statement that a person or a program makes about a span of time, such as "participant 1 speaks from
  here to there".

  An annotation has an interval, a track (a row of the timeline, such as one per person), a value for each attribute
  of the stream's `Situ.Annotation.Schema`, and its author:

    * `from`, `to`: ns, `from <= to`; both are equal for a point in time
    * `track`: the annotations of one track do not overlap, but they may touch
    * `values`: `%{"Speaker" => "P1", "Laughs" => false}`
    * `by`: the annotator or program, or `nil`; `confidence`: 0.0..1.0 or `nil`
    * `proposed?`: whether a program suggested it and nobody has accepted it yet
    * `note`: free text; `id`: a number that does not change when the annotation is edited

  **Annotations are an ordinary stream**: a message is the list of the annotations that end at its originating time,
  at most one per track, sorted by track. They are recorded, replayed, joined and queried like any other stream.

      iex> a = Situ.Annotation.new(0, 10, "P1", %{"Speaks" => true})
      iex> b = Situ.Annotation.new(10, 20, "P1", %{"Speaks" => false})
      iex> {Situ.Annotation.overlap?(a, b), Situ.Annotation.contains?(a, 10)}
      {false, true}
      iex> Situ.Annotation.to_messages([b, a]) |> Enum.map(&{&1.originating_time, length(&1.data)})
      [{10, 1}, {20, 1}]

  | to | see |
  |---|---|
  | describe attributes, their values, colours and keys | `Situ.Annotation.Schema` |
  | store, edit and check the annotations of a stream | `Situ.Annotation.Layer` |
  | change several annotations together | `Situ.Annotation.Edit` |
  | move annotations in time, alone or with all later ones | `Situ.Annotation.Shift` |
  | undo and redo, keep unsaved edits through a crash | `Situ.Annotation.Editor` |
  | read them from and write them to a recording | `Situ.Annotation.Recording` |
  | derive them from a stream of booleans or maps | `Situ.Annotation.Segmenting` |
  | derive them from messages that contain a start and an end | `Situ.Annotation.Spans` |
  | exchange them with ELAN, Praat, WebVTT and others | `Situ.Annotation.Exchange` |
  | compare two annotators | `Situ.Annotation.Agreement` |
  | compare any number, and make one layer of theirs | `Situ.Annotation.Consensus` |
  """
  # See docs/adr/0091-annotations-are-streams-with-versions.md.
  alias Situ.{Error, Message}

  @enforce_keys [:from, :to, :track]
  defstruct [:from, :to, :track, :id, :by, :confidence, :note, values: %{}, proposed?: false]

  @type t :: %__MODULE__{
          from: Situ.Time.t(),
          to: Situ.Time.t(),
          track: String.t(),
          id: pos_integer() | nil,
          by: String.t() | nil,
          confidence: float() | nil,
          note: String.t() | nil,
          values: %{String.t() => Situ.Annotation.Schema.value()},
          proposed?: boolean()
        }

  @doc "Builds an annotation; `more` sets the other fields. Raises `ArgumentError` if it ends before it begins."
  @spec new(Situ.Time.t(), Situ.Time.t(), String.t(), map(), keyword()) :: t()
  def new(from, to, track, values \\ %{}, more \\ []) do
    annotation = struct!(%__MODULE__{from: from, to: to, track: track, values: values}, more)

    case check_fields(annotation) do
      :ok -> annotation
      {:error, error} -> raise ArgumentError, Exception.message(error)
    end
  end

  @doc "Checks the types of the fields and that the interval does not end before it begins. Error: `:bad_annotation`."
  @spec check_fields(t()) :: :ok | {:error, Error.t()}
  def check_fields(%__MODULE__{from: from, to: to} = a) do
    cond do
      not (is_integer(from) and is_integer(to)) ->
        annotation_error("`from` or `to` is not an integer (ns)")

      from > to ->
        annotation_error("it ends #{Situ.Time.format_duration(from - to)} before it begins")

      not valid_text?(a.track) or a.track == "" ->
        annotation_error("its track has no name")

      not is_map(a.values) or not Enum.all?(Map.keys(a.values), &valid_text?/1) ->
        annotation_error("its values are not a map with names as keys")

      a.confidence != nil and not unit_interval?(a.confidence) ->
        annotation_error("its confidence is not between 0.0 and 1.0")

      not Enum.all?([a.by, a.note], &(&1 == nil or valid_text?(&1))) ->
        annotation_error("its annotator or note is not a string")

      not is_boolean(a.proposed?) ->
        annotation_error("`proposed?` is not a boolean")

      true ->
        :ok
    end
  end

  defp valid_text?(value), do: is_binary(value) and String.valid?(value)
  defp unit_interval?(value), do: is_number(value) and value >= 0 and value <= 1

  defp annotation_error(why) do
    {:error,
     Error.new(:bad_annotation, "invalid annotation", why: why, fix: "correct its fields")}
  end

  @doc """
  Returns whether two annotations of one track exclude each other: they share more than a point, they end together,
  or one is a point inside the other.
  """
  @spec overlap?(t(), t()) :: boolean()
  def overlap?(%{from: a, to: b}, %{from: c, to: d}), do: b == d or (a < d and c < b)

  @doc "Returns whether `time` is in the interval; both ends are included."
  @spec contains?(t(), Situ.Time.t()) :: boolean()
  def contains?(%__MODULE__{from: from, to: to}, time), do: from <= time and time <= to

  @doc "Returns the duration (`to - from`) in ns."
  @spec duration(t()) :: Situ.Time.duration()
  def duration(%__MODULE__{from: from, to: to}), do: to - from

  @doc "Returns the messages of an annotation stream, one per end time; creation times equal originating times."
  @spec to_messages([t()]) :: [Message.t()]
  def to_messages(annotations) do
    annotations
    |> Enum.group_by(& &1.to)
    |> Enum.sort()
    |> Enum.with_index(1)
    |> Enum.map(fn {{to, together}, n} ->
      data = Enum.sort_by(together, & &1.track)
      %Message{data: data, originating_time: to, creation_time: to, sequence_id: n}
    end)
  end

  @doc "Converts an annotation to a map for JSON: `from` and `to` in ns, without fields that are empty."
  @spec to_json(t()) :: map()
  def to_json(%__MODULE__{} = annotation) do
    annotation
    |> Map.from_struct()
    |> Enum.reject(fn {key, value} -> value == nil or {key, value} == {:proposed?, false} end)
    |> Map.new(fn {key, value} -> {key |> to_string() |> String.trim_trailing("?"), value} end)
  end

  @doc "Builds an annotation from a map that `to_json/1` returned."
  @spec from_json(term()) :: {:ok, t()} | {:error, Error.t()}
  def from_json(%{} = json) do
    annotation = %__MODULE__{
      from: json["from"],
      to: json["to"],
      track: json["track"],
      id: if(is_integer(json["id"]) and json["id"] > 0, do: json["id"]),
      by: json["by"],
      confidence: json["confidence"],
      note: json["note"],
      values: json["values"] || %{},
      proposed?: json["proposed"] || false
    }

    with :ok <- check_fields(annotation), do: {:ok, annotation}
  end

  def from_json(_), do: annotation_error("it is not a JSON object")
end
