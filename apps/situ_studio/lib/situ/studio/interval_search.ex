defmodule Situ.Studio.IntervalSearch do
  @moduledoc false
  # Implements "Find the times where": evaluates an expression over the streams of a page and
  # returns intervals (`Situ.Query`). The intervals become proposed annotations, which the user
  # accepts or rejects.
  alias Situ.Dataset.{OpenSession, Partition, Session}
  alias Situ.{Error, Query}
  alias Situ.Studio.Catalog.Item

  @timeout_ms 60_000
  @most 1_000

  @doc "Returns the recordings of an item as partitions by name; empty for data that is only in memory."
  @spec searchable_parts(Item.t()) :: [{String.t(), Path.t()}]
  def searchable_parts(%Item{kind: :session, parts: parts}), do: parts

  def searchable_parts(%Item{kind: kind, path: path}) when kind in [:store, :elsewhere],
    do: [{"Recording", path}]

  def searchable_parts(_), do: []

  @doc """
  Returns the intervals in which the expression is true, up to 1,000; `truncated?` is true if
  there are more.

      iex> {:error, error} = Situ.Studio.IntervalSearch.run_query([{"Room", "/nowhere/room.0000"}], "Level >")
      iex> error.code
      :bad_expression
  """
  @spec run_query([{String.t(), Path.t()}], String.t()) ::
          {:ok, Query.found()} | {:error, Error.t()}
  def run_query(parts, text) do
    with {:ok, expression} <- Situ.Expression.parse(text),
         {:ok, session} <- build_session(parts),
         do:
           session
           |> OpenSession.open()
           |> Query.run(expression, limit: @most, timeout: @timeout_ms)
  end

  defp build_session(parts) do
    Enum.reduce_while(parts, {:ok, Session.new("page")}, fn {name, path}, {:ok, session} ->
      case Session.add_partition(session, Partition.new(name, path)) do
        {:ok, session} -> {:cont, {:ok, session}}
        error -> {:halt, error}
      end
    end)
  end
end
