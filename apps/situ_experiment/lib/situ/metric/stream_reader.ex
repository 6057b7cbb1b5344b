defmodule Situ.Metric.StreamReader do
  @moduledoc false
  # Converts messages to the values that metrics compare. A state, such as a boolean, holds until the next message; the
  # last one has no duration, as in `Situ.Annotation.Segmenting`.
  alias Situ.{Annotation, Error, Message, Rect}

  @doc "Returns the intervals in which each track is true, or annotated: `%{track => [{from, to}]}`."
  @spec read_intervals(Enumerable.t()) :: %{String.t() => [{Situ.Time.t(), Situ.Time.t()}]}
  def read_intervals(messages) do
    for {track, segments} <- read_segments(messages), into: %{} do
      {track, for({from, to, label} <- segments, label != "false", do: {from, to})}
    end
  end

  @doc "Returns the labels of each track: `%{track => [{from, to, label}]}`."
  @spec read_segments(Enumerable.t()) ::
          %{String.t() => [{Situ.Time.t(), Situ.Time.t(), String.t()}]}
  def read_segments(messages) do
    case Enum.to_list(messages) do
      [%Message{data: data} | _] = messages when is_list(data) -> group_annotations(messages)
      messages -> hold_states(messages)
    end
  end

  defp group_annotations(messages) do
    for(%Message{data: data} <- messages, %Annotation{} = a <- data, do: a)
    |> Enum.sort_by(& &1.from)
    |> Enum.group_by(& &1.track, &{&1.from, &1.to, label_of(Map.values(&1.values))})
  end

  defp hold_states(messages) do
    messages
    |> Enum.zip(Enum.drop(messages, 1))
    |> Enum.flat_map(fn {%Message{} = message, next} ->
      for {track, label} <- state_tracks(message.data),
          do: {track, {message.originating_time, next.originating_time, label}}
    end)
    |> Enum.group_by(&elem(&1, 0), &elem(&1, 1))
    |> Map.new(fn {track, segments} -> {track, join_equal(segments)} end)
  end

  defp state_tracks(%{} = map) when not is_struct(map),
    do: for({key, value} <- map, do: {text_of(key), text_of(value)})

  defp state_tracks(nil), do: []
  defp state_tracks(value), do: [{"", text_of(value)}]

  defp join_equal(segments) do
    segments
    |> Enum.reduce([], fn
      {from, to, label}, [{first, from, label} | rest] -> [{first, to, label} | rest]
      segment, done -> [segment | done]
    end)
    |> Enum.reverse()
  end

  defp label_of([]), do: "true"
  defp label_of(values), do: Enum.map_join(values, " ", &text_of/1)

  defp text_of(text) when is_binary(text), do: text
  defp text_of(value) when is_atom(value) or is_number(value), do: to_string(value)
  defp text_of(value), do: inspect(value)

  @doc """
  Pairs each true message with the message at the nearest time within `tolerance`: `[{truth, output | nil}]`. Each
  output message is in at most one pair.
  """
  @spec pair_messages(Enumerable.t(), Enumerable.t(), Situ.Time.duration()) ::
          [{Message.t(), Message.t() | nil}]
  def pair_messages(truth, output, tolerance),
    do: pair_next(Enum.to_list(truth), Enum.to_list(output), tolerance)

  defp pair_next([], _output, _tolerance), do: []

  defp pair_next([truth | rest], output, tolerance) do
    output = Enum.drop_while(output, &(distance(&1, truth) < -tolerance))

    case output do
      [first, second | _] = [_ | others] ->
        if abs(distance(second, truth)) < abs(distance(first, truth)) and
             not nearer_to_next?(second, truth, rest),
           do: pair_next([truth | rest], others, tolerance),
           else: take_first(truth, first, others, {rest, tolerance})

      [first] ->
        take_first(truth, first, [], {rest, tolerance})

      [] ->
        [{truth, nil} | pair_next(rest, [], tolerance)]
    end
  end

  defp take_first(truth, first, others, {rest, tolerance}) do
    if distance(first, truth) <= tolerance,
      do: [{truth, first} | pair_next(rest, others, tolerance)],
      else: [{truth, nil} | pair_next(rest, [first | others], tolerance)]
  end

  defp nearer_to_next?(message, truth, [next | _]),
    do: abs(distance(message, next)) < abs(distance(message, truth))

  defp nearer_to_next?(_message, _truth, []), do: false
  defp distance(message, other), do: message.originating_time - other.originating_time

  @doc "Returns the text of all messages: strings, structs with `text`, or annotations."
  @spec read_text(Enumerable.t()) :: String.t()
  def read_text(messages), do: Enum.map_join(messages, " ", &message_text(&1.data))

  defp message_text(text) when is_binary(text), do: text
  defp message_text(%{text: text}) when is_binary(text), do: text

  defp message_text(annotations) when is_list(annotations) do
    Enum.map_join(annotations, " ", fn
      %Annotation{values: values} -> label_of(Map.values(values))
      other -> message_text(other)
    end)
  end

  defp message_text(other), do: raise(shape_error("a text", other))

  @doc """
  Returns who said what and when, as `{speaker, from, to, text}`: annotations with the speaker as their track, maps from
  speakers to texts, or structs with `speaker` and `text`. A text without an interval is at the time of its message.
  """
  @spec read_utterances(Enumerable.t()) :: [
          {String.t(), Situ.Time.t(), Situ.Time.t(), String.t()}
        ]
  def read_utterances(messages), do: Enum.flat_map(messages, &list_utterances(&1.data, &1))

  defp list_utterances(list, message) when is_list(list),
    do: Enum.flat_map(list, &list_utterances(&1, message))

  defp list_utterances(%Annotation{} = a, _message),
    do: [{a.track, a.from, a.to, label_of(Map.values(a.values))}]

  defp list_utterances(%{speaker: speaker, text: text} = said, message) when is_binary(text),
    do: [utterance(speaker, said, message)]

  defp list_utterances(%{} = map, message) when not is_struct(map) do
    for {speaker, said} <- map do
      case said do
        text when is_binary(text) -> utterance(speaker, %{text: text}, message)
        %{text: text} when is_binary(text) -> utterance(speaker, said, message)
        other -> raise shape_error("a text for each speaker", other)
      end
    end
  end

  defp list_utterances(other, _message),
    do: raise(shape_error("annotations, or a map of texts", other))

  defp utterance(speaker, said, message) do
    time = message.originating_time
    {text_of(speaker), Map.get(said, :from) || time, Map.get(said, :to) || time, said.text}
  end

  @doc "Returns the number of a message."
  @spec read_number(Message.t()) :: number()
  def read_number(%Message{data: number}) when is_number(number), do: number
  def read_number(%Message{data: other}), do: raise(shape_error("a number", other))

  @doc "Returns the boxes of a message, as `{rect, label, score}`."
  @spec read_boxes(Message.t() | nil) :: [{Rect.t(), String.t(), number()}]
  def read_boxes(nil), do: []
  def read_boxes(%Message{data: items}) when is_list(items), do: Enum.map(items, &read_box/1)
  def read_boxes(%Message{data: other}), do: raise(shape_error("a list of boxes", other))

  defp read_box(%Rect{} = rect), do: {rect, "", 1.0}

  defp read_box(%{rect: %Rect{} = rect} = item),
    do: {rect, text_of(Map.get(item, :label) || ""), Map.get(item, :score) || 1.0}

  defp read_box(other), do: raise(shape_error("a box", other))

  @doc "Returns the boxes of a message by their id."
  @spec read_tracks(Message.t() | nil) :: %{term() => Rect.t()}
  def read_tracks(nil), do: %{}

  def read_tracks(%Message{data: %{} = map}) when not is_struct(map),
    do: Map.new(map, fn {id, item} -> {id, item |> read_box() |> elem(0)} end)

  def read_tracks(%Message{data: items}) when is_list(items),
    do: Map.new(items, fn item -> {Map.get(item, :id), item |> read_box() |> elem(0)} end)

  def read_tracks(%Message{data: other}), do: raise(shape_error("a map of boxes", other))

  defp shape_error(wanted, other) do
    Error.new(
      :bad_shape,
      "the metric needs #{wanted} in each message, not #{inspect(other, limit: 5)}",
      fix: "name another stream, or convert it in build/3"
    )
  end
end
