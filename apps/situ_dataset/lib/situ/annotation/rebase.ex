defmodule Situ.Annotation.Rebase do
  @moduledoc false
  # Rebases transactions that were made on one version of a layer onto a version that another program has saved.
  # Annotations are matched by their content, because each program assigns its own ids.
  alias Situ.{Annotation, Error}
  alias Situ.Annotation.Layer

  @doc "Applies the transactions to the layer; returns both, or the error of the first transaction that does not fit."
  @spec rebase_onto(Layer.t(), [Layer.transaction()]) ::
          {:ok, Layer.t(), [Layer.transaction()]} | {:error, Error.t()}
  def rebase_onto(%Layer{} = layer, transactions) do
    transactions
    |> Enum.reduce_while({layer, %{}, []}, &rebase_step/2)
    |> case do
      {:error, error} -> {:error, error}
      {layer, _ids, done} -> {:ok, layer, Enum.reverse(done)}
    end
  end

  defp rebase_step(transaction, {layer, ids, done}) do
    with {:ok, changes, ids} <- rebase_transaction(transaction, layer, ids),
         {:ok, layer} <- Layer.apply_transaction(layer, changes) do
      {:cont, {layer, ids, [changes | done]}}
    else
      error -> {:halt, error}
    end
  end

  defp rebase_transaction(transaction, layer, ids) do
    transaction
    |> Enum.reduce_while({[], ids, layer.next}, fn change, {changes, ids, next} ->
      case rebase_change(change, layer, ids, next) do
        {:ok, {id, _, _} = moved} ->
          {:cont, {[moved | changes], Map.put(ids, elem(change, 0), id), max(next, id + 1)}}

        error ->
          {:halt, error}
      end
    end)
    |> case do
      {:error, error} -> {:error, error}
      {changes, ids, _} -> {:ok, Enum.reverse(changes), ids}
    end
  end

  defp rebase_change({id, nil, new}, _layer, ids, next) do
    # An undo restores an annotation that was deleted before.
    id = Map.get(ids, id, next)
    {:ok, {id, nil, with_id(new, id)}}
  end

  defp rebase_change({id, old, new}, layer, ids, _next) do
    case find_counterpart(layer, ids[id], old) do
      nil ->
        {:error,
         Error.new(:stale_edit, "an edited annotation was changed or deleted by another program")}

      match ->
        {:ok, {match.id, match, with_id(new, match.id)}}
    end
  end

  defp find_counterpart(layer, nil, %Annotation{} = old) do
    Enum.find(Layer.on_track(layer, old.track), &(with_id(&1, nil) == with_id(old, nil)))
  end

  defp find_counterpart(layer, id, _old) do
    case Layer.fetch(layer, id) do
      {:ok, match} -> match
      {:error, _} -> nil
    end
  end

  defp with_id(nil, _), do: nil
  defp with_id(annotation, id), do: %{annotation | id: id}
end
