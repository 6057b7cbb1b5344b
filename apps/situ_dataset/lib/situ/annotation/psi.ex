defmodule Situ.Annotation.Psi do
  @moduledoc false
  # Decodes annotations that Microsoft's \psi recorded. Their stream consists of sets, which
  # contain the annotations that end at the message's time, at most one per track. The schema is
  # the stream's metadata. `Situ.Annotation.Recording` reads these streams like streams of Situ.
  alias Situ.Annotation

  @set "Microsoft.Psi.Data.Annotations.TimeIntervalAnnotationSet"

  # System.Drawing.Color: state 2 means that the colour was given as a number, not as a name known to .NET.
  @given 2

  @doc "Returns whether a stream's messages are annotation sets of \\psi."
  @spec annotation_stream?(Situ.Store.StreamInfo.t()) :: boolean()
  def annotation_stream?(info), do: info.type_name == @set

  @doc "Decodes the annotations of one set, sorted by track."
  @spec decode_annotations(term()) :: {:ok, [Annotation.t()]} | :error
  def decode_annotations(%{"data" => %{} = tracks}) do
    tracks
    |> Enum.sort()
    |> Enum.reduce_while({:ok, []}, fn {_track, one}, {:ok, done} ->
      case decode_annotation(one) do
        {:ok, annotation} -> {:cont, {:ok, [annotation | done]}}
        :error -> {:halt, :error}
      end
    end)
    |> case do
      {:ok, done} -> {:ok, Enum.reverse(done)}
      :error -> :error
    end
  end

  def decode_annotations(_data), do: :error

  defp decode_annotation(%{
         "Interval" => %{
           "LeftEndpoint" => %{"Point" => from},
           "RightEndpoint" => %{"Point" => to}
         },
         "Track" => track,
         "AttributeValues" => %{} = values
       }) do
    values = for {name, held} <- values, into: %{}, do: {name, decode_value(held)}
    annotation = %Annotation{from: from, to: to, track: track_name(track), values: values}
    if Annotation.check_fields(annotation) == :ok, do: {:ok, annotation}, else: :error
  end

  defp decode_annotation(_other), do: :error

  # In \psi, a track may be unnamed.
  defp track_name(name) when name in [nil, ""], do: "Track"
  defp track_name(name), do: name

  defp decode_value(%{"Value" => value})
       when is_binary(value) or is_number(value) or is_boolean(value),
       do: value

  defp decode_value(%{"Value" => value}) when value != nil, do: inspect(value)
  defp decode_value(_none), do: ""

  @doc "Converts a schema of \\psi to the JSON form of `Situ.Annotation.Schema`."
  @spec convert_schema(term()) :: {:ok, map()} | :error
  def convert_schema(%{"Name" => name, "AttributeSchemas" => [_ | _] = attributes}) do
    {:ok, %{"name" => name, "attributes" => Enum.map(attributes, &convert_attribute/1)}}
  end

  def convert_schema(_term), do: :error

  defp convert_attribute(%{"Name" => name, "ValueSchema" => %{} = values} = attribute) do
    drop_nil_fields(%{
      "name" => name,
      "description" => attribute["Description"],
      "fill" => convert_colour(values["FillColor"]),
      "text" => convert_colour(values["TextColor"])
    })
    |> Map.merge(kind_fields(values))
  end

  # The schema parser will report why this attribute is invalid.
  defp convert_attribute(other), do: other

  defp kind_fields(%{"PossibleValues" => [%{"Value" => first} | _] = values} = schema)
       when is_binary(first) do
    drop_nil_fields(%{
      "kind" => "finite",
      "default" => schema["DefaultValue"],
      "values" =>
        for(
          v <- values,
          do:
            drop_nil_fields(%{
              "value" => v["Value"],
              "fill" => convert_colour(v["FillColor"]),
              "text" => convert_colour(v["TextColor"])
            })
        )
    })
  end

  defp kind_fields(%{"DefaultValue" => default}) when is_boolean(default),
    do: %{"kind" => "bool", "default" => default}

  defp kind_fields(%{"DefaultValue" => default}) when is_number(default),
    do: %{"kind" => "number", "default" => default}

  defp kind_fields(%{"DefaultValue" => default}) when is_binary(default),
    do: %{"kind" => "text", "default" => default}

  defp kind_fields(_), do: %{"kind" => "text"}

  defp convert_colour(%{"value" => argb, "state" => state}) when is_integer(argb) do
    import Bitwise, only: [&&&: 2]

    if (state &&& @given) != 0,
      do: "#" <> Base.encode16(<<argb &&& 0xFFFFFF::24>>, case: :lower)
  end

  defp convert_colour(_), do: nil

  defp drop_nil_fields(map),
    do: for({key, value} <- map, value != nil, into: %{}, do: {key, value})
end
