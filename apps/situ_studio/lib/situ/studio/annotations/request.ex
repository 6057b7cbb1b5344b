defmodule Situ.Studio.Annotations.Request do
  @moduledoc false
  # Applies the edits that a page requests to a layer. The input is untrusted.
  alias Situ.{Annotation, Error}
  alias Situ.Annotation.{Edit, Layer, Shift}
  alias Situ.Studio.Int64

  @doc "Applies the edit `name` with its parameters to the layer."
  @spec apply_change(String.t(), Layer.t(), map()) :: Layer.edited()
  def apply_change("add", layer, %{"from" => from, "to" => to, "track" => track} = params) do
    with {:ok, from} <- parse_time(from),
         {:ok, to} <- parse_time(to),
         {:ok, track} <- parse_name(track) do
      values = parse_values(params["values"])
      by = parse_author(params["by"])
      Edit.annotate(layer, Annotation.new(min(from, to), max(from, to), track, values, by: by))
    end
  end

  # A key frame is the position of a box or point at one time; it replaces an existing key frame at that time.
  def apply_change("key_frame", layer, %{"at" => at, "track" => track} = params) do
    with {:ok, at} <- parse_time(at), {:ok, track} <- parse_name(track) do
      values = parse_values(params["values"])

      case Enum.find(Layer.on_track(layer, track), &(&1.from == at and &1.to == at)) do
        nil ->
          Layer.add(layer, Annotation.new(at, at, track, values, by: parse_author(params["by"])))

        old ->
          Layer.change(layer, old.id, values: Map.merge(old.values, values))
      end
    end
  end

  def apply_change("interval", layer, %{"id" => id, "from" => from, "to" => to}) do
    with {:ok, id} <- parse_id(id),
         {:ok, from} <- parse_time(from),
         {:ok, to} <- parse_time(to),
         do: Edit.set_interval(layer, id, {min(from, to), max(from, to)})
  end

  def apply_change("confidence", layer, %{"id" => id, "confidence" => confidence})
      when confidence == nil or (is_number(confidence) and confidence >= 0 and confidence <= 1),
      do:
        with(
          {:ok, id} <- parse_id(id),
          do: Layer.change(layer, id, confidence: confidence && confidence / 1)
        )

  def apply_change("delete_track", layer, %{"track" => track}),
    do: Edit.delete_track(layer, to_string(track))

  def apply_change("edge", layer, %{"id" => id, "edge" => edge, "to" => to} = params)
      when edge in ["from", "to"] do
    edge = if edge == "from", do: :from, else: :to

    with {:ok, id} <- parse_id(id),
         {:ok, to} <- parse_time(to),
         do: Edit.move_edge(layer, id, edge, to, alone: params["alone"] == true)
  end

  def apply_change("ripple", layer, %{"id" => id, "edge" => edge, "to" => to})
      when edge in ["from", "to"] do
    edge = if edge == "from", do: :from, else: :to

    with {:ok, id} <- parse_id(id),
         {:ok, to} <- parse_time(to),
         do: Shift.ripple_edge(layer, id, edge, to)
  end

  def apply_change("shift", layer, %{"id" => id, "by" => by}) do
    with {:ok, id} <- parse_id(id),
         {:ok, by} <- parse_time(by),
         do: Shift.shift_annotations(layer, [id], by)
  end

  def apply_change("shift_after", layer, %{"at" => at, "by" => by}) do
    with {:ok, at} <- parse_time(at),
         {:ok, by} <- parse_time(by),
         do: Shift.shift_after(layer, at, by)
  end

  def apply_change("close_gap", layer, %{"id" => id}),
    do: with({:ok, id} <- parse_id(id), do: Shift.close_gap(layer, id))

  def apply_change("remove", layer, %{"id" => id}),
    do: with({:ok, id} <- parse_id(id), do: Layer.remove(layer, id))

  def apply_change("value", layer, %{"id" => id, "attribute" => attribute, "value" => value}),
    do:
      with({:ok, id} <- parse_id(id), do: Layer.set_value(layer, id, to_string(attribute), value))

  def apply_change("split", layer, %{"id" => id, "at" => at}),
    do:
      with(
        {:ok, id} <- parse_id(id),
        {:ok, at} <- parse_time(at),
        do: Edit.split_annotation(layer, id, at)
      )

  def apply_change("merge", layer, %{"id" => id, "with" => other}),
    do:
      with(
        {:ok, id} <- parse_id(id),
        {:ok, other} <- parse_id(other),
        do: Edit.merge_annotations(layer, id, other)
      )

  def apply_change("note", layer, %{"id" => id, "note" => note}) when is_binary(note),
    do:
      with(
        {:ok, id} <- parse_id(id),
        do: Layer.change(layer, id, note: String.slice(note, 0, 2_000))
      )

  def apply_change("accept", layer, %{"id" => id} = params),
    do:
      with(
        {:ok, id} <- parse_id(id),
        do: Layer.accept_proposal(layer, id, parse_author(params["by"]))
      )

  # Corrects the values of a proposal and accepts it, in one step.
  def apply_change("correct", layer, %{"id" => id, "values" => values} = params) do
    with {:ok, id} <- parse_id(id), {:ok, old} <- Layer.fetch(layer, id) do
      by = parse_author(params["by"]) || old.by
      values = Map.merge(old.values, parse_values(values))
      Layer.change(layer, id, values: values, proposed?: false, by: by)
    end
  end

  def apply_change("accept_all", layer, params),
    do: Edit.accept_all(layer, parse_min_confidence(params["least"]))

  # Proposals without a confidence count as certain, so only `all` rejects them.
  def apply_change("reject_all", layer, %{"all" => true}), do: Edit.reject_all(layer, 2.0)

  def apply_change("reject_all", layer, params),
    do: Edit.reject_all(layer, parse_min_confidence(params["least"]))

  def apply_change("to_track", layer, %{"id" => id, "track" => track}) do
    with {:ok, id} <- parse_id(id),
         {:ok, track} <- parse_name(track),
         do: Layer.change(layer, id, track: track)
  end

  # The source track may be in this layer or in the layer in `params`.
  def apply_change("copy_boundaries", layer, %{"of" => of, "track" => track} = params) do
    with {:ok, track} <- parse_name(track) do
      source = params[:layer] || layer
      Edit.copy_boundaries(layer, Layer.on_track(source, to_string(of)), track)
    end
  end

  def apply_change("rename_track", layer, %{"track" => from, "name" => to}),
    do: with({:ok, to} <- parse_name(to), do: Edit.rename_track(layer, to_string(from), to))

  def apply_change(_, _, _), do: invalid_edit()

  defp parse_author(name) do
    case parse_name(name) do
      {:ok, name} -> name
      _ -> nil
    end
  end

  defp parse_values(%{} = values), do: Map.filter(values, fn {key, _} -> is_binary(key) end)
  defp parse_values(_), do: %{}

  defp parse_time(text) do
    with :error <- Int64.parse(text), do: invalid_edit()
  end

  defp parse_id(id) when is_integer(id), do: {:ok, id}
  defp parse_id(_), do: invalid_edit()

  defp parse_name(name) when is_binary(name) do
    name = name |> String.trim() |> String.slice(0, 60)
    if name == "", do: invalid_edit(), else: {:ok, name}
  end

  defp parse_name(_), do: invalid_edit()

  defp parse_min_confidence(x) when is_number(x) and x >= 0 and x <= 1, do: x / 1
  defp parse_min_confidence(_), do: 0.0

  defp invalid_edit, do: {:error, Error.new(:bad_request, "invalid annotation edit")}
end
