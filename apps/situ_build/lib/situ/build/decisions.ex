defmodule Situ.Build.Decisions do
  @moduledoc false
  # Checks that each decision record in `docs/adr` is cited by at least one file outside that
  # folder.
  #
  # A record that no code and no page cites is a record that nobody finds.

  alias Situ.Build.Checkout

  @folder "docs/adr/"

  @doc "Returns one sentence for each decision record of the checkout at `root` that nothing cites."
  @spec find_violations(Path.t()) :: [String.t()]
  def find_violations(root) do
    {records, others} =
      root |> Checkout.list_files() |> Enum.split_with(&String.starts_with?(&1, @folder))

    texts = for file <- others, text?(file), do: File.read!(Path.join(root, file))

    for name <- find_uncited(Enum.map(records, &Path.basename/1), texts),
        do: "nothing cites #{@folder}#{name}"
  end

  @doc """
  Returns the names of the records that none of the texts contains.

      iex> Situ.Build.Decisions.find_uncited(["0001-a.md", "0002-b.md", "README.md"], ["# See docs/adr/0002-b.md."])
      ["0001-a.md"]
  """
  @spec find_uncited([String.t()], [String.t()]) :: [String.t()]
  def find_uncited(records, texts) do
    Enum.reject(records, fn name ->
      name == "README.md" or Enum.any?(texts, &String.contains?(&1, name))
    end)
  end

  defp text?(file), do: Path.extname(file) in ~w(.ex .exs .rs .js .mjs .md .sh .toml .cpp .h)
end
