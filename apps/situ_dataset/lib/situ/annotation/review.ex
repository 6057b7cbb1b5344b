defmodule Situ.Annotation.Review do
  @moduledoc false
  # Records the outcome of reviewing proposals, so that progress can be counted. The outcomes follow from transactions,
  # so an undone edit also undoes its outcome. They are stored with the layer.
  alias Situ.Annotation

  @typedoc "The outcome of each proposal by its id. `:changed` is a proposal that was changed but not yet accepted."
  @type t :: %{pos_integer() => :accepted | :corrected | :rejected | :changed}
  @type progress :: %{
          total: non_neg_integer(),
          reviewed: non_neg_integer(),
          accepted: non_neg_integer(),
          rejected: non_neg_integer(),
          corrected: non_neg_integer()
        }

  @outcomes [:accepted, :corrected, :rejected, :changed]

  @doc "Updates the outcomes with a transaction of a layer."
  @spec record_transaction(t(), [{pos_integer(), Annotation.t() | nil, Annotation.t() | nil}]) ::
          t()
  def record_transaction(review, transaction),
    do: Enum.reduce(transaction, review, &record_change/2)

  defp record_change({id, %{proposed?: true}, nil}, review), do: Map.put(review, id, :rejected)

  defp record_change({id, %{proposed?: true} = old, %{proposed?: false} = new}, review) do
    corrected? = review[id] == :changed or changed?(old, new)
    Map.put(review, id, if(corrected?, do: :corrected, else: :accepted))
  end

  defp record_change({id, %{proposed?: true} = old, %{proposed?: true} = new}, review),
    do: if(changed?(old, new), do: Map.put(review, id, :changed), else: review)

  # The proposal is new, or its review was undone.
  defp record_change({id, old, %{proposed?: true} = new}, %{} = review) do
    if review[id] == :corrected and old != nil and not changed?(old, new),
      do: Map.put(review, id, :changed),
      else: Map.delete(review, id)
  end

  defp record_change(_change, review), do: review

  defp changed?(old, new),
    do: {old.from, old.to, old.track, old.values} != {new.from, new.to, new.track, new.values}

  @doc "Forgets the proposals that a transaction added, when it is undone: they were not rejected."
  @spec forget_added(t(), [{pos_integer(), Annotation.t() | nil, Annotation.t() | nil}]) :: t()
  def forget_added(review, transaction) do
    ids = for {id, nil, %{proposed?: true}} <- transaction, do: id
    Map.drop(review, ids)
  end

  @doc "Counts the outcomes; `open` is the number of proposals that are neither accepted nor rejected."
  @spec summarize(t(), non_neg_integer()) :: progress()
  def summarize(review, open) do
    counts = review |> Map.values() |> Enum.frequencies()
    corrected = Map.get(counts, :corrected, 0)
    accepted = Map.get(counts, :accepted, 0) + corrected
    rejected = Map.get(counts, :rejected, 0)
    reviewed = accepted + rejected

    %{
      total: reviewed + open,
      reviewed: reviewed,
      accepted: accepted,
      rejected: rejected,
      corrected: corrected
    }
  end

  @doc """
  Converts the outcomes to a JSON object: the ids of each outcome.

      iex> Situ.Annotation.Review.to_json(%{1 => :accepted, 2 => :rejected, 3 => :accepted})
      %{"accepted" => [1, 3], "rejected" => [2]}
  """
  @spec to_json(t()) :: map()
  def to_json(review) do
    review
    |> Enum.sort()
    |> Enum.group_by(fn {_, outcome} -> Atom.to_string(outcome) end, fn {id, _} -> id end)
  end

  @doc "Reads a JSON object that `to_json/1` returned; ignores other data."
  @spec from_json(term()) :: t()
  def from_json(%{} = json) do
    for outcome <- @outcomes,
        ids = json[Atom.to_string(outcome)],
        is_list(ids),
        id <- ids,
        is_integer(id) and id > 0,
        into: %{},
        do: {id, outcome}
  end

  def from_json(_), do: %{}
end
