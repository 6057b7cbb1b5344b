defmodule Situ.Annotation.Psi do
  @moduledoc """
  Annotations as Microsoft's \\psi records them: a stream of sets, each with the annotations that end at its time, one
  of each track; the schema is the stream's metadata. `Situ.Annotation.Recording` reads them like our own.
  """
  alias Situ.Annotation

  @set "Microsoft.Psi.Data.Annotations.TimeIntervalAnnotationSet"

  # System.Drawing.Color: its number was given (2), not one of the names that .NET knows.
  @given 2

  @doc "Whether a stream's messages are such sets."
  @spec annotations?(Situ.Store.StreamInfo.t()) :: boolean()
  def annotations?(info), do: info.type_name == @set

  @doc "The annotations of one set, sorted by track."
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

  # A track need not have a name there.
  defp track(name) when name in [nil, ""], do: "Track"
  defp track(name), do: name

  defp value(%{"Value" => value}) when is_binary(value) or is_number(value) or is_boolean(value),
    do: value

  defp value(%{"Value" => value}) when value != nil, do: inspect(value)
  defp value(_none), do: ""

  @doc "The JSON form of `Situ.Annotation.Schema` of a schema of \\psi's."
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

  # No schema of ours: its parser tells why.
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
