defmodule Situ.Build.Commits do
  @moduledoc false
  # Checks the subjects of commits: a scope, then an imperative sentence, with at most 72
  # characters.
  #
  #     studio: list only the latest version of each annotation

  @max 72
  # This commit and all earlier ones are older than the rule.
  @since "d80771c9"
  # These first words look like participles or third-person verbs, but are allowed: they are imperatives, or mark a
  # revert.
  @imperatives ~w(pass process express address access compress press stress discuss focus need feed embed speed bring
    revert)

  @doc """
  Returns one sentence for each commit that breaks the rule and is newer than it. Shallow clones and sources without
  git history are not checked.
  """
  @spec find_violations(Path.t()) :: [String.t()]
  def find_violations(root) do
    case System.cmd("git", ["log", "--no-merges", "--format=%h %s", "#{@since}..HEAD"],
           cd: root,
           stderr_to_stdout: true
         ) do
      {log, 0} ->
        for line <- String.split(log, "\n", trim: true),
            problem <- check_line(line),
            do: problem

      {_error, _status} ->
        []
    end
  end

  defp check_line(line) do
    [hash, subject] = String.split(line, " ", parts: 2)
    for problem <- check_subject(subject), do: "commit #{hash} \"#{subject}\" #{problem}"
  end

  @doc """
  Returns the problems of a subject.

      iex> Situ.Build.Commits.check_subject("store: reject a truncated index")
      []
      iex> Situ.Build.Commits.check_subject("store: rejected a truncated index")
      ["does not begin with an imperative after its scope"]
      iex> Situ.Build.Commits.check_subject("Reject a truncated index")
      ["does not begin with a scope and a colon"]
  """
  @spec check_subject(String.t()) :: [String.t()]
  def check_subject(subject) do
    check_length(subject) ++ check_form(Regex.run(~r/^[^:]{1,40}: (\S+)/, subject))
  end

  defp check_length(subject) do
    if String.length(subject) > @max,
      do: ["has #{String.length(subject)} characters; the limit is #{@max}"],
      else: []
  end

  defp check_form(nil), do: ["does not begin with a scope and a colon"]

  defp check_form([_, word]) do
    if word in @imperatives or
         (word =~ ~r/^[a-z]+$/ and not (word =~ ~r/(ed|ing|[^s]s)$|^(the|a|an|no|its|of|in)$/)),
       do: [],
       else: ["does not begin with an imperative after its scope"]
  end
end
