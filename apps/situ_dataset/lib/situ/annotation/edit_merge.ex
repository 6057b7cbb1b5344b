defmodule Situ.Annotation.EditMerge do
  @moduledoc false
  # Decides whether an edit that a person made while looking at an earlier version can be merged: nobody else has
  # changed the same fields of an annotation since, nor deleted it, nor changed the tier of its track.
  alias Situ.Annotation.{Layer, LayerOperation, Schema}
  alias Situ.EditLog.Entry
  alias Situ.Error

  @doc """
  Checks a transaction against the entries (newest first) after the option `version:` (default: none) that a person
  other than `by:` has made. Error: `:stale_edit`, which names the other person.
  """
  @spec check_version([Entry.t()], Layer.transaction(), keyword()) :: :ok | {:error, Error.t()}
  def check_version(entries, transaction, opts) do
    mine = Entry.new("edit", %{}, by: opts[:by])
    wanted = list_fields(transaction)

    entries
    |> Enum.take_while(&(opts[:version] != nil and &1.n > opts[:version]))
    |> Enum.reject(&same_person?(&1, mine))
    |> Enum.find_value(:ok, fn entry ->
      cond do
        overlaps?(entry, wanted) -> {:error, stale_error(entry, "the annotation was")}
        changes_tier?(entry.do, transaction) -> {:error, stale_error(entry, "the tiers were")}
        true -> nil
      end
    end)
  end

  defp changes_tier?(%{"schema" => [before, later]}, transaction) do
    with {:ok, before} <- Schema.parse(before), {:ok, later} <- Schema.parse(later) do
      tracks = for {_, a, b} <- transaction, %{track: track} <- [a, b], uniq: true, do: track
      Enum.any?(tracks, &(Schema.find_tier(before, &1) != Schema.find_tier(later, &1)))
    else
      _ -> false
    end
  end

  defp changes_tier?(_operation, _transaction), do: false

  defp same_person?(entry, mine), do: Entry.same_user?(entry, mine) and entry.by == mine.by

  defp overlaps?(entry, wanted) do
    {:ok, transaction} = LayerOperation.parse_transaction(entry.do)

    Enum.any?(list_fields(transaction), fn {id, fields} -> fields_overlap?(fields, wanted[id]) end)
  end

  defp fields_overlap?(_theirs, nil), do: false
  defp fields_overlap?(:all, _mine), do: true
  defp fields_overlap?(_theirs, :all), do: true
  defp fields_overlap?(theirs, mine), do: theirs -- theirs -- mine != []

  # Both ends of an interval are one field, because they depend on each other.
  defp list_fields(transaction) do
    for {id, before, later} <- transaction, before != nil, into: %{} do
      if later == nil,
        do: {id, :all},
        else: {id, before |> LayerOperation.changed_fields(later) |> Enum.map(&field_group/1)}
    end
  end

  defp field_group(field) when field in [:from, :to, :track], do: :interval
  defp field_group(field), do: field

  defp stale_error(entry, subject) do
    Error.new(:stale_edit, "#{subject} changed by someone else",
      why:
        "#{entry.by || entry.user || "another user"} did it at #{entry.at} with #{entry.program}",
      fix: "look at the change, and repeat the edit if it is still wanted"
    )
  end
end
