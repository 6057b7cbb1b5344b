defmodule Situ.Studio.Annotating.Request do
  @moduledoc false
  # Applies the edits that a page requests to a layer. The input is untrusted.
  alias Situ.{Annotation, Error}
  alias Situ.Annotation.{Edit, Layer}
  alias Situ.Studio.WholeNumber

  @doc "Applies the edit `name` with its parameters to the layer."
  @spec change(String.t(), Layer.t(), map()) :: Layer.edited()
  def change("add", layer, %{"from" => from, "to" => to, "track" => track} = params) do
    with {:ok, from} <- time(from),
         {:ok, to} <- time(to),
         {:ok, track} <- name(track) do
      values = values(params["values"])
      by = by(params["by"])
      Layer.add(layer, Annotation.new(min(from, to), max(from, to), track, values, by: by))
    end
  end

  # A key frame is the position of a box or point at one time; it replaces an existing key frame at that time.
  def change("key_frame", layer, %{"at" => at, "track" => track} = params) do
    with {:ok, at} <- time(at), {:ok, track} <- name(track) do
      values = values(params["values"])

      case Enum.find(Layer.on_track(layer, track), &(&1.from == at and &1.to == at)) do
        nil -> Layer.add(layer, Annotation.new(at, at, track, values, by: by(params["by"])))
        old -> Layer.change(layer, old.id, values: Map.merge(old.values, values))
      end
    end
  end

  def change("interval", layer, %{"id" => id, "from" => from, "to" => to}) do
    with {:ok, id} <- id(id),
         {:ok, from} <- time(from),
         {:ok, to} <- time(to),
         do: Edit.set_interval(layer, id, {min(from, to), max(from, to)})
  end

  def change("confidence", layer, %{"id" => id, "confidence" => confidence})
      when confidence == nil or (is_number(confidence) and confidence >= 0 and confidence <= 1),
      do:
        with(
          {:ok, id} <- id(id),
          do: Layer.change(layer, id, confidence: confidence && confidence / 1)
        )

  def change("delete_track", layer, %{"track" => track}),
    do: Edit.delete_track(layer, to_string(track))

  def change("edge", layer, %{"id" => id, "edge" => edge, "to" => to} = params)
      when edge in ["from", "to"] do
    edge = if edge == "from", do: :from, else: :to

    with {:ok, id} <- id(id),
         {:ok, to} <- time(to),
         do: Edit.move_edge(layer, id, edge, to, alone: params["alone"] == true)
  end

  def change("remove", layer, %{"id" => id}),
    do: with({:ok, id} <- id(id), do: Layer.remove(layer, id))

  def change("value", layer, %{"id" => id, "attribute" => attribute, "value" => value}),
    do: with({:ok, id} <- id(id), do: Layer.set_value(layer, id, to_string(attribute), value))

  def change("split", layer, %{"id" => id, "at" => at}),
    do: with({:ok, id} <- id(id), {:ok, at} <- time(at), do: Edit.split(layer, id, at))

  def change("merge", layer, %{"id" => id, "with" => other}),
    do: with({:ok, id} <- id(id), {:ok, other} <- id(other), do: Edit.merge(layer, id, other))

  def change("note", layer, %{"id" => id, "note" => note}) when is_binary(note),
    do: with({:ok, id} <- id(id), do: Layer.change(layer, id, note: String.slice(note, 0, 2_000)))

  def change("accept", layer, %{"id" => id}),
    do: with({:ok, id} <- id(id), do: Layer.accept(layer, id))

  def change("accept_all", layer, params), do: Edit.accept_all(layer, least(params["least"]))

  # Proposals without a confidence count as certain, so only `all` rejects them.
  def change("reject_all", layer, %{"all" => true}), do: Edit.reject_all(layer, 2.0)
  def change("reject_all", layer, params), do: Edit.reject_all(layer, least(params["least"]))

  def change("to_track", layer, %{"id" => id, "track" => track}) do
    with {:ok, id} <- id(id),
         {:ok, track} <- name(track),
         do: Layer.change(layer, id, track: track)
  end

  # The source track may be in this layer or in the layer in `params`.
  def change("copy_boundaries", layer, %{"of" => of, "track" => track} = params) do
    with {:ok, track} <- name(track) do
      source = params[:layer] || layer
      Edit.copy_boundaries(layer, Layer.on_track(source, to_string(of)), track)
    end
  end

  def change("rename_track", layer, %{"track" => from, "name" => to}),
    do: with({:ok, to} <- name(to), do: Edit.rename_track(layer, to_string(from), to))

  def change(_, _, _), do: bad()

  defp by(name) do
    case name(name) do
      {:ok, name} -> name
      _ -> nil
    end
  end

  defp values(%{} = values), do: Map.filter(values, fn {key, _} -> is_binary(key) end)
  defp values(_), do: %{}

  defp time(text) do
    with :error <- WholeNumber.parse(text), do: bad()
  end

  defp id(id) when is_integer(id), do: {:ok, id}
  defp id(_), do: bad()

  defp name(name) when is_binary(name) do
    name = name |> String.trim() |> String.slice(0, 60)
    if name == "", do: bad(), else: {:ok, name}
  end

  defp name(_), do: bad()

  defp least(x) when is_number(x) and x >= 0 and x <= 1, do: x / 1
  defp least(_), do: 0.0

  defp bad, do: {:error, Error.new(:bad_request, "invalid annotation edit")}
end
