defmodule Situ.EditLog.Versions do
  @moduledoc false
  # Finds versions by number or name, and the edits that a person can undo or redo. A version is the state after the
  # operation with that number.
  alias Situ.EditLog.Entry
  alias Situ.Error

  @doc """
  Returns the number of a version: `12`, `v12`, a name, or `now`. A name that was given several times is the last one.
  Error: `:no_version`.
  """
  @spec find_version([Entry.t()], String.t()) :: {:ok, non_neg_integer()} | {:error, Error.t()}
  def find_version(entries, text) do
    named = for %{kind: "name", note: ^text, of: n} when is_integer(n) <- entries, do: n

    cond do
      named != [] -> {:ok, List.last(named)}
      text == "now" -> {:ok, length(entries)}
      true -> parse_number(entries, text)
    end
  end

  defp parse_number(entries, text) do
    case text |> String.trim_leading("v") |> Integer.parse() do
      {n, ""} when n >= 0 and n <= length(entries) -> {:ok, n}
      _ -> {:error, no_version_error(entries, text)}
    end
  end

  defp no_version_error(entries, text) do
    names = for %{kind: "name", note: name} <- entries, do: inspect(name)
    numbers = "0 to #{length(entries)}"

    Error.new(:no_version, "version #{text} does not exist",
      why: "the versions are #{Enum.join([numbers | Enum.uniq(names)], ", ")}",
      fix: "choose from these; the history lists them"
    )
  end

  @doc """
  Returns the edits that the user of `mine` can undo and redo, newest first. Edits of other users, and
  edits before the oldest entry in the list, are not included.
  """
  @spec undo_stacks([Entry.t()], Entry.t()) :: {undo :: [Entry.t()], redo :: [Entry.t()]}
  def undo_stacks(entries, mine),
    do:
      entries
      |> Enum.filter(&Entry.same_user?(&1, mine))
      |> Enum.reduce({[], []}, &push_entry(&2, &1))

  defp push_entry({undo, redo}, %{kind: "undo", of: n}), do: move_entry(undo, redo, n)

  defp push_entry({undo, redo}, %{kind: "redo", of: n}) do
    {redo, undo} = move_entry(redo, undo, n)
    {undo, redo}
  end

  defp push_entry({undo, _redo}, %{kind: kind} = entry) when kind in ["edit", "restore"],
    do: {[entry | undo], []}

  defp push_entry(stacks, _entry), do: stacks

  defp move_entry(from, to, n) do
    case Enum.split_with(from, &(&1.n == n)) do
      {[entry], rest} -> {rest, [entry | to]}
      {[], _} -> {from, to}
    end
  end
end
