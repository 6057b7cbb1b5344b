defmodule Situ.Build.Sources do
  @moduledoc false
  # Checks the text of sources: Elixir, HEEx, Rust, JavaScript, CSS, scripts and documents.
  #
  # A file has at most 300 lines of code (blank lines, comments and documentation are not
  # counted). A line has at most 120 characters; in documents, lines with tables, links and images
  # may be longer, and so may commands in scripts.

  alias Situ.Build.Checkout

  @max_line 120
  @max_code 300
  @kinds ~w(.ex .exs .heex .rs .js .mjs .css .md)
  @code ~w(.ex .rs .js .mjs)

  @doc """
  Returns one sentence, with the line, for each rule that a file tracked by git in the checkout at `root` breaks.
  """
  @spec find_violations(Path.t()) :: [String.t()]
  def find_violations(root) do
    for file <- source_files(root),
        problem <- check_text(file, File.read!(Path.join(root, file))),
        do: problem
  end

  @doc """
  Returns the same sentences for the text of one file.

      iex> Situ.Build.Sources.check_text("a.ex", "x = 1")
      []
      iex> Situ.Build.Sources.check_text("a.ex", String.duplicate("x", 121))
      ["a.ex:1 has 121 characters; a line has at most 120"]
  """
  @spec check_text(Path.t(), String.t()) :: [String.t()]
  def check_text(file, text) do
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

    long_lines ++ too_much_code(file, kind, count_code_lines(kind, without_tests(kind, lines)))
  end

  @doc """
  Returns the number of these lines that are code.

      iex> Situ.Build.Sources.count_code_lines(".rs", ["// why", "", "fn main() {}"])
      1
  """
  @spec count_code_lines(String.t(), [String.t()]) :: non_neg_integer()
  def count_code_lines(kind, lines) do
    lines |> Enum.reduce({0, nil}, &count_line(kind, String.trim(&1), &2)) |> elem(0)
  end

  # In Rust, unit tests are at the end of the file that they test.
  defp without_tests(".rs", lines), do: Enum.take_while(lines, &(&1 != "#[cfg(test)]"))
  defp without_tests(_kind, lines), do: lines

  defp too_much_code(file, kind, n) when kind in @code and n > @max_code do
    if String.contains?(file, ["/test/", "test/", "/tests/", "bench/", "priv/"]),
      do: [],
      else: ["#{file} has #{n} lines of code; a file has at most #{@max_code}"]
  end

  defp too_much_code(_file, _kind, _n), do: []

  # Documentation begins with a line that has an attribute and opens a heredoc; it ends with the line that closes it.
  defp count_line(".ex", "\"\"\"" <> _, {n, :doc}), do: {n, nil}
  defp count_line(_kind, _line, {n, :doc}), do: {n, :doc}
  defp count_line(_kind, "", counted), do: counted
  defp count_line(".ex", "#" <> _, counted), do: counted

  defp count_line(".ex", line, {n, nil}) do
    doc? = String.match?(line, ~r/^@(module|type)?doc\b/)

    if doc? and String.ends_with?(line, "\"\"\""),
      do: {n, :doc},
      else: {if(doc?, do: n, else: n + 1), nil}
  end

  defp count_line(_kind, "//" <> _, counted), do: counted
  defp count_line(_kind, "*" <> _, counted), do: counted
  defp count_line(_kind, "/*" <> _, counted), do: counted
  defp count_line(_kind, _line, {n, nil}), do: {n + 1, nil}

  # Table rows, links, images and long words cannot be broken.
  defp unbreakable?(".md", line), do: String.contains?(line, ["|", "](", "://"])

  defp unbreakable?(_kind, line),
    do: String.contains?(line, "://") or String.starts_with?(String.trim(line), "|")

  defp source_files(root) do
    root
    |> Checkout.list_files()
    |> Enum.filter(&(source_file?(&1) and not String.contains?(&1, ["/vendor/", "/fixtures/"])))
  end

  # Scripts have no extension: they are in bin/, or are called `run` in test/. Their lines may have any length.
  defp source_file?(path) do
    Path.extname(path) in @kinds or
      (Path.extname(path) == "" and (match?("bin/" <> _, path) or Path.basename(path) == "run"))
  end
end
