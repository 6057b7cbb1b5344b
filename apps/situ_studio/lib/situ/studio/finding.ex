defmodule Situ.Studio.Finding do
  @moduledoc """
  "Find the times where": an expression over the streams that a page shows, answered with intervals
  (`Situ.Query`). The intervals become proposals of annotations, of which the user keeps the good ones.

      iex> {:error, error} = Situ.Studio.Finding.run([{"Room", "/nowhere/room.0000"}], "Level >")
      iex> error.code
      :bad_expression
  """
  alias Situ.Dataset.{OpenSession, Partition, Session}
  alias Situ.{Error, Query}
  alias Situ.Studio.Catalog.Item

  @timeout_ms 60_000
  @most 1_000

  @doc "The recordings of an item, as partitions by name; none of what lies only in memory."
  @spec parts(Item.t()) :: [{String.t(), Path.t()}]
  def parts(%Item{kind: :session, parts: parts}), do: parts

  def parts(%Item{kind: kind, path: path}) when kind in [:store, :elsewhere],
    do: [{"Recording", path}]

  def parts(_), do: []

  @doc "The intervals in which the expression is true: at most 1,000, `truncated?` when there are more."
  @spec run([{String.t(), Path.t()}], String.t()) :: {:ok, Query.found()} | {:error, Error.t()}
  def run(parts, text) do
    with {:ok, expression} <- Situ.Expression.parse(text),
         {:ok, session} <- session(parts),
         do:
           session
           |> OpenSession.open()
           |> Query.run(expression, limit: @most, timeout: @timeout_ms)
  end

  defp session(parts) do
    Enum.reduce_while(parts, {:ok, Session.new("page")}, fn {name, path}, {:ok, session} ->
      case Session.add(session, Partition.new(name, path)) do
        {:ok, session} -> {:cont, {:ok, session}}
        error -> {:halt, error}
      end
    end)
  end
end
