# Makes the notebooks from the guides: `elixir notebooks/make.exs` in this folder. A notebook of Livebook is Markdown,
# so a guide only gets a title, a cell that installs Situ, and a last cell that shows something.
root = Path.expand("../../..", __DIR__)

install = ~S"""
```elixir
situ = System.get_env("SITU_HOME", "/home/me/situ")
Mix.install([{:situ_livebook, path: Path.join(situ, "integrations/situ_livebook")}])
```
"""

ten = ~S"""
```elixir
folder = Path.join(System.tmp_dir!(), "situ_ten_lines")

{:ok, report} =
  Situ.Pipeline.run(fn p ->
    degrees = Situ.sequence(p, 20.0, &(&1 + 0.1), every: Situ.Time.ms(100), count: 50)
    knocks = Situ.from_enumerable(p, 0..3, every: Situ.Time.s(1))
    store = Situ.Store.create(p, "first", folder)

    Situ.Store.write(degrees, store, "Degrees")

    knocks
    |> Situ.join(degrees, Situ.Reproducible.nearest(Situ.Time.ms(60)))
    |> Situ.each(&IO.inspect/1)
    |> Situ.Store.write(store, "KnockTemperature")
  end)

report
```

The report shows the graph. The recording shows its streams:

```elixir
{:ok, recording} = Situ.Store.open(Path.join(folder, "first"))
recording
```

A live pipeline, with buttons:

```elixir
Situ.Livebook.run(
  fn p ->
    count = Situ.sequence(p, 0, &(&1 + 1), every: Situ.Time.ms(50), name: "Count")
    Situ.map(count, &:math.sin(&1 / 20), name: "Sine")
  end,
  show: ["Sine"]
)
```
"""

last = ~S"""
## In this notebook

```elixir
Situ.Livebook.run(
  fn p -> p |> Situ.sequence(0, &(&1 + 1), every: Situ.Time.ms(50)) |> Situ.map(&:math.sin(&1 / 20), name: "Sine") end,
  show: ["Sine"]
)
```
"""

folder = Path.join(root, "integrations/situ_livebook/notebooks")

write = fn name, title, text ->
  text = "# #{title}\n\n## Setup\n\n#{install}\n#{text}"
  File.write!(Path.join(folder, name <> ".livemd"), text)
end

write.("ten_lines", "Ten lines", "## Ten lines\n\n" <> ten)

for name <-
      ~w(your-first-pipeline choosing-a-delivery-policy fusing-streams recording-and-replaying writing-a-component) do
  ["# " <> title, text] =
    Path.join(root, "docs/guides/#{name}.md") |> File.read!() |> String.split("\n", parts: 2)

  # A notebook makes its own pictures. Links lead to the other guides, which are not next to the notebook.
  text = String.replace(text, ~r/^!\[.*\]\(.*\)\n\n/m, "")

  text =
    String.replace(
      text,
      ~r/\]\((?!http)([\w.\/-]+)/,
      "](https://github.com/situ/situ/blob/main/docs/guides/\\1"
    )

  write.(
    String.replace(name, "-", "_"),
    title,
    text |> String.trim() |> Kernel.<>("\n\n" <> last)
  )
end
