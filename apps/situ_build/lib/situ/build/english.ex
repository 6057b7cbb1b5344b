defmodule Situ.Build.English do
  @moduledoc false
  # Counts habits of unclear English in documents, docs and comments. `Situ.Build.Limits` keeps
  # the number from rising.
  #
  # A match is a place to look at, not an error, and some matches are good English. To fix a
  # match, rewrite the sentence; a synonym is not enough.

  @habits [
    {"is no NOUN", ~r/\b(?:is|are|was|were) no (?!longer|more)[a-z]+/},
    {"tell, told", ~r/\b(?:is|are|was|be) told\b|\btells?\b/},
    {"whoever", ~r/\b[Ww]hoever\b|(?:^|[.:;,] )[Ww]ho [a-z]+s\b/m},
    {"clause with \"what\" as a noun",
     ~r/\b(?:what|all that) (?:is|was|are|it|they|he|has|comes|came|others|the|one|follows|fits|needs|cannot|can)\b/},
    {"sentence that begins with \"What\"", ~r/(?:^[ #>\/*-]*|[.:!] |")What [a-z][^.?!]*[.!]/m},
    {"fragment with \"Of\"", ~r/(?:^|[.:"] ?)Of (?:a|an|one|the|all|several|each|every)\b/m},
    {"of its own", ~r/\bof (?:its|their|one's|your|his) own\b/},
    {"lie, stand", ~r/\b(?:lie|lies|stands?|stood)\b/},
    {"answer", ~r/\b[Aa]nswers?\b/},
    {"behind, beside", ~r/\b(?:behind|beside)\b/},
    {"one that, those that", ~r/\b(?:one|those|that) (?:that|which|of|who)\b/},
    {"goes on, under way",
     ~r/\b(?:go(?:es)? on|under way|on (?:its|their) way|meanwhile|at once)\b/}
  ]

  @doc "Counts the habits per 1,000 words in the documents and sources of the checkout at `root`."
  @spec measure(Path.t()) :: float()
  def measure(root) do
    texts =
      for path <- document_paths(root) ++ source_paths(root),
          do: extract_prose(path, File.read!(path))

    words = texts |> Enum.map(&length(String.split(&1))) |> Enum.sum()
    1000 * (texts |> Enum.map(&length(find_habits(&1))) |> Enum.sum()) / max(words, 1)
  end

  @doc """
  Returns the name of the habit of each match in `text`.

      iex> Situ.Build.English.find_habits("There is no index.")
      ["is no NOUN"]
      iex> Situ.Build.English.find_habits("The index does not exist.")
      []
  """
  @spec find_habits(String.t()) :: [String.t()]
  def find_habits(text) do
    for {habit, pattern} <- @habits, _match <- Regex.scan(pattern, text), do: habit
  end

  @doc ~S'''
  Returns the sentences of a file's text: a document without its code blocks, or the docs and comments of a source file.

      iex> Situ.Build.English.extract_prose("a.ex", "# Why.\n@doc \"Adds.\"\ndef add(a, b), do: a + b")
      "Why.\nAdds."
  '''
  @spec extract_prose(Path.t(), String.t()) :: String.t()
  def extract_prose(path, text) do
    case Path.extname(path) do
      ".md" -> Regex.replace(~r/```.*?```/s, text, "")
      ".ex" -> Enum.join(comment_texts(text) ++ doc_texts(text), "\n")
    end
  end

  # Consecutive lines of comments form one text.
  defp comment_texts(text) do
    for [block] <- Regex.scan(~r/(?:^\s*# .*\n)+/m, text),
        do:
          block
          |> String.split("\n", trim: true)
          |> Enum.map_join(" ", &Regex.replace(~r/^\s*# ?/, &1, ""))
  end

  defp doc_texts(text) do
    patterns = [
      ~r/@(?:module|type)?doc\s+(?:~S)?"""(.*?)"""/s,
      ~r/(?:doc|why|fix):?\s+"((?:[^"\\]|\\.)*)"/
    ]

    for pattern <- patterns,
        [_, doc] <- Regex.scan(pattern, text),
        do: Regex.replace(~r/^\s*iex>.*$|^ {4}.*$/m, doc, "")
  end

  defp document_paths(root) do
    Enum.flat_map(
      ~w(*.md docs/**/*.md apps/*/README.md),
      &Path.wildcard(Path.join(root, &1))
    )
  end

  defp source_paths(root), do: Path.wildcard(Path.join(root, "apps/*/lib/**/*.ex"))
end
