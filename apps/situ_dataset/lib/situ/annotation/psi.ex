defmodule Situ.Annotation.Psi do
  @moduledoc """
  Decodes annotations that Microsoft's \\psi recorded. Their stream consists of sets, which contain the annotations
  that end at the message's time, at most one per track. The schema is the stream's metadata.
  `Situ.Annotation.Recording` reads these streams like streams of Situ.
  """
  alias Situ.Annotation

  @set "Microsoft.Psi.Data.Annotations.TimeIntervalAnnotationSet"

  # System.Drawing.Color: state 2 means that the colour was given as a number, not as a name known to .NET.
  @given 2

  @doc "Returns whether a stream's messages are annotation sets of \\psi."
  @spec annotations?(Situ.Store.StreamInfo.t()) :: boolean()
  def annotations?(info), do: info.type_name == @set

  @doc "Decodes the annotations of one set, sorted by track."
  @spec annotations(term()) :: {:ok, [Annotation.t()]} | :error
  def annotations(%{"data" => %{} = tracks}) do
    tracks
    |> Enum.sort()
    |> Enum.reduce_while({:ok, []}, fn {_track, one}, {:ok, done} ->
      case annotation(one) do
        {:ok, annotation} -> {:cont, {:ok, [annotation | done]}}
        :error -> {:halt, :error}
      end
    end)
    |> case do
      {:ok, done} -> {:ok, Enum.reverse(done)}
      :error -> :error
    end
  end

  def annotations(_data), do: :error

  defp annotation(%{
         "Interval" => %{
           "LeftEndpoint" => %{"Point" => from},
           "RightEndpoint" => %{"Point" => to}
         },
         "Track" => track,
         "AttributeValues" => %{} = values
       }) do
    values = for {name, held} <- values, into: %{}, do: {name, value(held)}
    annotation = %Annotation{from: from, to: to, track: track(track), values: values}
    if Annotation.check(annotation) == :ok, do: {:ok, annotation}, else: :error
  end

  defp annotation(_other), do: :error

  # In \psi, a track may be unnamed.
  defp track(name) when name in [nil, ""], do: "Track"
  defp track(name), do: name

  defp value(%{"Value" => value}) when is_binary(value) or is_number(value) or is_boolean(value),
    do: value

  defp value(%{"Value" => value}) when value != nil, do: inspect(value)
  defp value(_none), do: ""

  @doc "Converts a schema of \\psi to the JSON form of `Situ.Annotation.Schema`."
  @spec schema(term()) :: {:ok, map()} | :error
  def schema(%{"Name" => name, "AttributeSchemas" => [_ | _] = attributes}) do
    {:ok, %{"name" => name, "attributes" => Enum.map(attributes, &attribute/1)}}
  end

  def schema(_term), do: :error

  defp attribute(%{"Name" => name, "ValueSchema" => %{} = values} = attribute) do
    held(%{
      "name" => name,
      "description" => attribute["Description"],
      "fill" => colour(values["FillColor"]),
      "text" => colour(values["TextColor"])
    })
    |> Map.merge(kind(values))
  end

  # The schema parser will report why this attribute is invalid.
  defp attribute(other), do: other

  defp kind(%{"PossibleValues" => [%{"Value" => first} | _] = values} = schema)
       when is_binary(first) do
    held(%{
      "kind" => "finite",
      "default" => schema["DefaultValue"],
      "values" =>
        for(
          v <- values,
          do:
            held(%{
              "value" => v["Value"],
              "fill" => colour(v["FillColor"]),
              "text" => colour(v["TextColor"])
            })
        )
    })
  end

  defp kind(%{"DefaultValue" => default}) when is_boolean(default),
    do: %{"kind" => "bool", "default" => default}

  defp kind(%{"DefaultValue" => default}) when is_number(default),
    do: %{"kind" => "number", "default" => default}

  defp kind(%{"DefaultValue" => default}) when is_binary(default),
    do: %{"kind" => "text", "default" => default}

  defp kind(_), do: %{"kind" => "text"}

  defp colour(%{"value" => argb, "state" => state}) when is_integer(argb) do
    import Bitwise, only: [&&&: 2]

    if (state &&& @given) != 0,
      do: "#" <> Base.encode16(<<argb &&& 0xFFFFFF::24>>, case: :lower)
  end

  defp colour(_), do: nil

  defp held(map), do: for({key, value} <- map, value != nil, into: %{}, do: {key, value})
end
