defmodule Situ.Annotation.Exchange.LabelStudio do
  @moduledoc false
  # Reads and writes Label Studio's JSON for audio or video. A file is one task with a region per
  # annotation, and times are seconds from `origin:`.
  #
  # Finite attributes are `labels`, text is `textarea`, numbers are `number`, and booleans are
  # `choices` of `true` and `false`. The results of one region share its `id`. The track is the
  # region's choice `from_name: "track"`. Proposals are predictions with their confidence as the
  # score. All other annotations are annotations of the task, with one entry per annotator.
  @behaviour Situ.Annotation.Exchange
  alias Situ.Annotation
  alias Situ.Annotation.Exchange.LabelRows
  alias Situ.Annotation.{Layer, Schema}

  @impl true
  def encode(layer, opts) do
    {proposals, statements} = layer |> Layer.annotations() |> Enum.split_with(& &1.proposed?)

    task = %{
      "data" => %{"audio" => opts[:media] || ""},
      "meta" => %{
        "situ" => %{"schema" => Schema.to_json(layer.schema), "origin" => opts[:origin]}
      },
      "annotations" =>
        for {by, all} <- Enum.sort(Enum.group_by(statements, & &1.by)) do
          %{"result" => Enum.flat_map(all, &encode_results(&1, layer.schema, opts[:origin]))}
          |> Map.merge(if(by, do: %{"completed_by" => %{"email" => by}}, else: %{}))
        end,
      "predictions" =>
        for {by, all} <- Enum.sort(Enum.group_by(proposals, & &1.by)) do
          %{
            "model_version" => by || "situ",
            "result" => Enum.flat_map(all, &encode_results(&1, layer.schema, opts[:origin]))
          }
        end
    }

    {Situ.JSON.encode_pretty([task]) <> "\n",
     LabelRows.describe_losses(Layer.annotations(layer), [:note], "Label Studio")}
  end

  defp encode_results(a, schema, origin) do
    span = %{
      "start" => (a.from - origin) / 1.0e9,
      "end" => (a.to - origin) / 1.0e9,
      "channel" => 0
    }

    base = %{"id" => "situ-#{a.id}", "to_name" => "audio", "origin" => "manual"}
    base = if a.confidence, do: Map.put(base, "score", a.confidence), else: base

    track =
      Map.merge(base, %{
        "from_name" => "track",
        "type" => "choices",
        "value" => Map.put(span, "choices", [a.track])
      })

    [
      track
      | for(
          attribute <- schema.attributes,
          is_map_key(a.values, attribute.name),
          do: encode_result(attribute, a.values[attribute.name], span, base)
        )
    ]
  end

  defp encode_result(attribute, value, span, base) do
    {type, values} =
      case attribute.kind do
        :finite -> {"labels", [value]}
        :text -> {"textarea", [value]}
        :number -> {"number", value}
        :bool -> {"choices", [to_string(value)]}
      end

    key = if type == "textarea", do: "text", else: type

    Map.merge(base, %{
      "from_name" => attribute.name,
      "type" => type,
      "value" => Map.put(span, key, values)
    })
  end

  @impl true
  def decode(text, opts) do
    case Situ.JSON.decode(text) do
      {:ok, [%{} = task]} ->
        decode_task(task, opts)

      {:ok, %{"images" => _, "annotations" => _}} ->
        {:error, "it is a COCO file: pass format: :coco"}

      {:ok, %{} = task} ->
        decode_task(task, opts)

      {:ok, [_, _ | _]} ->
        {:error, "it contains several tasks; export a single task"}

      {:ok, _} ->
        {:error, "it is not a task of Label Studio"}

      {:error, :bad_json} ->
        {:error, "it is not JSON"}
    end
  end

  defp decode_task(task, opts) do
    own = situ_metadata(task)
    schema = opts[:schema] || parse_schema(own["schema"])
    origin = opts[:origin] || if(is_integer(own["origin"]), do: own["origin"], else: 0)

    statements =
      for %{} = entry <- list_or_empty(task["annotations"]),
          do: {annotator_email(entry["completed_by"]), false, list_or_empty(entry["result"])}

    proposals =
      for %{} = entry <- list_or_empty(task["predictions"]),
          do: {model_name(entry["model_version"]), true, list_or_empty(entry["result"])}

    {annotations, bad} =
      Enum.flat_map_reduce(statements ++ proposals, 0, fn {by, proposed?, results}, bad ->
        regions = results |> Enum.filter(&time_region?/1) |> Enum.group_by(& &1["id"])
        strange = length(results) - (regions |> Map.values() |> Enum.map(&length/1) |> Enum.sum())

        read =
          for {_, region} <- regions, do: decode_region(region, schema, origin, {by, proposed?})

        {for({:ok, a} <- read, do: a), bad + strange + Enum.count(read, &(&1 == :error))}
      end)

    losses =
      if bad > 0,
        do: [
          "#{bad} results are not regions in time or do not fit the schema, and are left out"
        ],
        else: []

    {:ok, schema, Enum.sort_by(annotations, &{&1.from, &1.to, &1.track}), losses}
  end

  defp situ_metadata(%{"meta" => %{"situ" => %{} = own}}), do: own
  defp situ_metadata(_), do: %{}

  defp parse_schema(nil), do: nil

  defp parse_schema(json) do
    case Schema.parse(json) do
      {:ok, schema} -> schema
      {:error, _} -> nil
    end
  end

  defp list_or_empty(value), do: if(is_list(value), do: value, else: [])
  defp annotator_email(%{"email" => email}) when is_binary(email), do: email
  defp annotator_email(_), do: nil
  defp model_name(text), do: if(is_binary(text) and text != "situ", do: text)

  defp time_region?(%{"id" => id, "type" => type, "value" => %{"start" => from, "end" => to}}),
    do: is_binary(id) and is_binary(type) and is_number(from) and is_number(to)

  defp time_region?(_), do: false

  defp decode_region(
         [%{"value" => %{"start" => from, "end" => to}} = first | _] = region,
         schema,
         origin,
         {by, proposed?}
       ) do
    {tracks, others} =
      Enum.split_with(region, &(&1["from_name"] == "track" and &1["type"] == "choices"))

    track =
      for %{"value" => %{"choices" => [track | _]}} when is_binary(track) <- tracks, do: track

    with {:ok, values} <- decode_values(others, schema),
         annotation = %Annotation{
           from: round(from * 1.0e9) + origin,
           to: round(to * 1.0e9) + origin,
           track: List.first(track) || "Regions",
           values: values,
           by: by,
           confidence: if(is_number(first["score"]), do: first["score"]),
           proposed?: proposed?
         },
         :ok <- Annotation.check_fields(annotation) do
      {:ok, annotation}
    else
      _ -> :error
    end
  end

  defp decode_values(results, schema) do
    Enum.reduce_while(results, {:ok, %{}}, fn result, {:ok, values} ->
      name = if is_binary(result["from_name"]), do: result["from_name"], else: "Value"

      with {:ok, value} <- result_value(result["type"], result["value"]),
           {:ok, value} <- check_value(schema, name, value) do
        {:cont, {:ok, Map.put(values, name, value)}}
      else
        _ -> {:halt, :error}
      end
    end)
  end

  defp result_value("labels", %{"labels" => [label | _]}), do: {:ok, label}
  defp result_value("timeserieslabels", %{"timeserieslabels" => [label | _]}), do: {:ok, label}
  defp result_value("textarea", %{"text" => [text | _]}), do: {:ok, text}
  defp result_value("textarea", %{"text" => text}), do: {:ok, text}
  defp result_value("number", %{"number" => number}), do: {:ok, number}
  defp result_value("choices", %{"choices" => [choice | _]}), do: {:ok, choice}
  defp result_value(_, _), do: :error

  defp check_value(nil, _name, value) when is_binary(value) or is_number(value), do: {:ok, value}
  defp check_value(nil, _name, _value), do: :error

  defp check_value(schema, name, value) when is_binary(value),
    do: Schema.parse_value(schema, name, value)

  defp check_value(schema, name, value),
    do: with(:ok <- Schema.check_values(schema, %{name => value}), do: {:ok, value})
end
