defmodule Situ.Build.Sources do
  @moduledoc """
  How long source files and their lines may be, for Elixir, HEEx, Rust, JavaScript, CSS and documents alike.

  A file holds at most 300 lines of code (blank lines, comments and documentation do not count), a line at most
  120 characters (tables, links and images of documents may be longer, as nothing can break them).
  """

  @max_line 120
  @max_code 300
  @kinds ~w(.ex .exs .heex .rs .js .mjs .css .md)
  @code ~w(.ex .rs .js .mjs)

  @doc """
  One sentence for every file of the checkout at `root` that git tracks and that is too long or has a line too long.
  """
  @spec violations(Path.t()) :: [String.t()]
  def violations(root) do
    for file <- tracked(root),
        problem <- problems(file, File.read!(Path.join(root, file))),
        do: problem
  end

  @doc """
  The same for one file's text.

      iex> Situ.Build.Sources.problems("a.ex", "x = 1")
      []
      iex> Situ.Build.Sources.problems("a.ex", String.duplicate("x", 121))
      ["a.ex:1 has 121 characters; a line has at most 120"]
  """
  @spec problems(Path.t(), String.t()) :: [String.t()]
  def problems(file, text) do
    kind = Path.extname(file)
    lines = String.split(text, "\n")

    long_lines =
      for {line, n} <- Enum.with_index(lines, 1),
          byte_size(line) > @max_line,
          length = String.length(line),
          length > @max_line,
          not unbreakable?(kind, line),
          do: "#{file}:#{n} has #{length} characters; a line has at most #{@max_line}"

    long_lines ++ too_much_code(file, kind, code_lines(kind, without_tests(kind, lines)))
  end

  @doc """
  How many of these lines are code.

      iex> Situ.Build.Sources.code_lines(".rs", ["// why", "", "fn main() {}"])
      1
  """
  @spec code_lines(String.t(), [String.t()]) :: non_neg_integer()
  def code_lines(kind, lines) do
    lines |> Enum.reduce({0, nil}, &count(kind, String.trim(&1), &2)) |> elem(0)
  end

  # Rust's unit tests stand at the end of the file that they test.
  defp without_tests(".rs", lines), do: Enum.take_while(lines, &(&1 != "#[cfg(test)]"))
  defp without_tests(_kind, lines), do: lines

  defp too_much_code(file, kind, n) when kind in @code and n > @max_code do
    if String.contains?(file, ["/test/", "test/", "/tests/", "bench/", "priv/"]),
      do: [],
      else: ["#{file} has #{n} lines of code; a file has at most #{@max_code}"]
  end

  defp too_much_code(_file, _kind, _n), do: []

  # Documentation runs from a line that opens a heredoc behind an attribute to the line that closes it.
  defp count(".ex", "\"\"\"" <> _, {n, :doc}), do: {n, nil}
  defp count(_kind, _line, {n, :doc}), do: {n, :doc}
  defp count(_kind, "", counted), do: counted
  defp count(".ex", "#" <> _, counted), do: counted

  defp count(".ex", line, {n, nil}) do
    doc? = String.match?(line, ~r/^@(module|type)?doc\b/)

    if doc? and String.ends_with?(line, "\"\"\""),
      do: {n, :doc},
      else: {if(doc?, do: n, else: n + 1), nil}
  end

  defp count(_kind, "//" <> _, counted), do: counted
  defp count(_kind, "*" <> _, counted), do: counted
  defp count(_kind, "/*" <> _, counted), do: counted
  defp count(_kind, _line, {n, nil}), do: {n + 1, nil}

  # A table's row, a link or a picture cannot be broken; nor can a long word.
  defp unbreakable?(".md", line), do: String.contains?(line, ["|", "](", "://"])

  defp unbreakable?(_kind, line),
    do: String.contains?(line, "://") or String.starts_with?(String.trim(line), "|")

  defp tracked(root) do
    {files, 0} = System.cmd("git", ["ls-files"], cd: root)

    files
    |> String.split("\n", trim: true)
    |> Enum.filter(&(Path.extname(&1) in @kinds and File.exists?(Path.join(root, &1))))
    |> Enum.reject(&String.contains?(&1, ["/vendor/", "/fixtures/"]))
  end
end
