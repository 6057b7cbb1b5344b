defmodule Situ.Build.Sources do
  @moduledoc """
  Rules of the sources' text, for Elixir, HEEx, Rust, JavaScript, CSS, scripts and documents alike.

  A file holds at most 300 lines of code (blank lines, comments and documentation do not count), a line at most
  120 characters (tables, links and images of documents, and commands of scripts, may be longer). No sentence begins
  with "What" as its subject: it hides who does it.
  """

  @max_line 120
  @max_code 300
  @kinds ~w(.ex .exs .heex .rs .js .mjs .css .md)
  # A line's or sentence's first word, perhaps behind the signs of a comment, list or text; a question is none of these.
  @what_subject ~r/(?:^[ #>\/*-]*|[.:!] |")What [a-z][^.?!]*[.!]/m
  @code ~w(.ex .rs .js .mjs)

  @doc """
  One sentence for every file of the checkout at `root` that git tracks and that breaks a rule, with the line.
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
      iex> Situ.Build.Sources.problems("a.md", "Yes.\\n\\n- What" <> " waits is lost. What" <> " is lost?")
      [~s(a.md:3 has a sentence that begins with "What"; begin with the agent)]
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
          kind in @kinds,
          not unbreakable?(kind, line),
          do: "#{file}:#{n} has #{length} characters; a line has at most #{@max_line}"

    long_lines ++
      what_subjects(file, text) ++
      too_much_code(file, kind, code_lines(kind, without_tests(kind, lines)))
  end

  defp what_subjects(file, text) do
    for [{at, length}] <- Regex.scan(@what_subject, text, return: :index) do
      word = at + (text |> binary_part(at, length) |> :binary.match("What") |> elem(0))
      line = text |> binary_part(0, word) |> :binary.matches("\n") |> length()
      "#{file}:#{line + 1} has a sentence that begins with \"What\"; begin with the agent"
    end
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
    |> Enum.filter(&(source?(&1) and File.exists?(Path.join(root, &1))))
    |> Enum.reject(&String.contains?(&1, ["/vendor/", "/fixtures/"]))
  end

  # Scripts have no extension: they are in bin/, and called `run` in test/. Their lines may be as long as a command is.
  defp source?(path) do
    Path.extname(path) in @kinds or
      (Path.extname(path) == "" and (match?("bin/" <> _, path) or Path.basename(path) == "run"))
  end
end
