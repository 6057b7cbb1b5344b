defmodule Situ.Annotation.Exchange.LabelStudio do
  @moduledoc """
  Label Studio's JSON for audio or video: one task with a region per annotation; times are seconds from `origin:`.

  Finite attributes are `labels`, text is `textarea`, numbers are `number`, and booleans are `choices` of `true` and
  `false`. The results of one region share its `id`. The track is the region's choice `from_name: "track"`. Proposals
  are predictions with their confidence as the score. All other annotations are annotations of the task, with one
  entry per annotator.
  """
  @behaviour Situ.Annotation.Exchange
  alias Situ.Annotation
  alias Situ.Annotation.Exchange.Rows
  alias Situ.Annotation.{Layer, Schema}

  @impl true
  def encode(layer, opts) do
    {proposed, given} = layer |> Layer.annotations() |> Enum.split_with(& &1.proposed?)

    task = %{
      "data" => %{"audio" => opts[:media] || ""},
      "meta" => %{
        "situ" => %{"schema" => Schema.to_json(layer.schema), "origin" => opts[:origin]}
      },
      "annotations" =>
        for {by, all} <- Enum.sort(Enum.group_by(given, & &1.by)) do
          %{"result" => Enum.flat_map(all, &results(&1, layer.schema, opts[:origin]))}
          |> Map.merge(if(by, do: %{"completed_by" => %{"email" => by}}, else: %{}))
        end,
      "predictions" =>
        for {by, all} <- Enum.sort(Enum.group_by(proposed, & &1.by)) do
          %{
            "model_version" => by || "situ",
            "result" => Enum.flat_map(all, &results(&1, layer.schema, opts[:origin]))
          }
        end
    }

    {Situ.JSON.pretty([task]) <> "\n",
     Rows.losses(Layer.annotations(layer), [:note], "Label Studio")}
  end

  defp results(a, schema, origin) do
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
          do: result(attribute, a.values[attribute.name], span, base)
        )
    ]
  end

  defp result(attribute, value, span, base) do
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
        task(task, opts)

      {:ok, %{"images" => _, "annotations" => _}} ->
        {:error, "it is a COCO file: pass format: :coco"}

      {:ok, %{} = task} ->
        task(task, opts)

      {:ok, [_, _ | _]} ->
        {:error, "it contains several tasks; export a single task"}

      {:ok, _} ->
        {:error, "it is not a task of Label Studio"}

      {:error, :bad_json} ->
        {:error, "it is not JSON"}
    end
  end

  defp task(task, opts) do
    own = situ(task)
    schema = opts[:schema] || schema(own["schema"])
    origin = opts[:origin] || if(is_integer(own["origin"]), do: own["origin"], else: 0)

    given =
      for %{} = entry <- list(task["annotations"]),
          do: {email(entry["completed_by"]), false, list(entry["result"])}

    proposed =
      for %{} = entry <- list(task["predictions"]),
          do: {said(entry["model_version"]), true, list(entry["result"])}

    {annotations, bad} =
      Enum.flat_map_reduce(given ++ proposed, 0, fn {by, proposed?, results}, bad ->
        regions = results |> Enum.filter(&region?/1) |> Enum.group_by(& &1["id"])
        strange = length(results) - (regions |> Map.values() |> Enum.map(&length/1) |> Enum.sum())
        read = for {_, region} <- regions, do: annotation(region, schema, origin, {by, proposed?})
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

  defp situ(%{"meta" => %{"situ" => %{} = own}}), do: own
  defp situ(_), do: %{}

  defp schema(nil), do: nil

  defp schema(json) do
    case Schema.parse(json) do
      {:ok, schema} -> schema
      {:error, _} -> nil
    end
  end

  defp list(value), do: if(is_list(value), do: value, else: [])
  defp email(%{"email" => email}) when is_binary(email), do: email
  defp email(_), do: nil
  defp said(text), do: if(is_binary(text) and text != "situ", do: text)

  defp region?(%{"id" => id, "type" => type, "value" => %{"start" => from, "end" => to}}),
    do: is_binary(id) and is_binary(type) and is_number(from) and is_number(to)

  defp region?(_), do: false

  defp annotation(
         [%{"value" => %{"start" => from, "end" => to}} = first | _] = region,
         schema,
         origin,
         {by, proposed?}
       ) do
    {tracks, others} =
      Enum.split_with(region, &(&1["from_name"] == "track" and &1["type"] == "choices"))

    track =
      for %{"value" => %{"choices" => [track | _]}} when is_binary(track) <- tracks, do: track

    with {:ok, values} <- values(others, schema),
         annotation = %Annotation{
           from: round(from * 1.0e9) + origin,
           to: round(to * 1.0e9) + origin,
           track: List.first(track) || "Regions",
           values: values,
           by: by,
           confidence: if(is_number(first["score"]), do: first["score"]),
           proposed?: proposed?
         },
         :ok <- Annotation.check(annotation) do
      {:ok, annotation}
    else
      _ -> :error
    end
  end

  defp values(results, schema) do
    Enum.reduce_while(results, {:ok, %{}}, fn result, {:ok, values} ->
      name = if is_binary(result["from_name"]), do: result["from_name"], else: "Value"

      with {:ok, value} <- value(result["type"], result["value"]),
           {:ok, value} <- fit(schema, name, value) do
        {:cont, {:ok, Map.put(values, name, value)}}
      else
        _ -> {:halt, :error}
      end
    end)
  end

  defp value("labels", %{"labels" => [label | _]}), do: {:ok, label}
  defp value("timeserieslabels", %{"timeserieslabels" => [label | _]}), do: {:ok, label}
  defp value("textarea", %{"text" => [text | _]}), do: {:ok, text}
  defp value("textarea", %{"text" => text}), do: {:ok, text}
  defp value("number", %{"number" => number}), do: {:ok, number}
  defp value("choices", %{"choices" => [choice | _]}), do: {:ok, choice}
  defp value(_, _), do: :error

  defp fit(nil, _name, value) when is_binary(value) or is_number(value), do: {:ok, value}
  defp fit(nil, _name, _value), do: :error
  defp fit(schema, name, value) when is_binary(value), do: Schema.read(schema, name, value)

  defp fit(schema, name, value),
    do: with(:ok <- Schema.check(schema, %{name => value}), do: {:ok, value})
end
