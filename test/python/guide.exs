# Runs the blocks of a guide in a folder: `guide.exs GUIDE PYTHON`. A Python block becomes the file that the text before
# it names. Elixir blocks run in order. A block that needs a package is left out if Python does not have it.
{:ok, _} = Application.ensure_all_started(:situ_python)
[guide, python] = System.argv()

has = fn package ->
  match?({_, 0}, System.cmd(python, ["-c", "import #{package}"], stderr_to_stdout: true))
end

run = fn
  "python", before, code, binding ->
    [[_, name] | _] = Enum.reverse(Regex.scan(~r/file `([\w.]+)`/, before))
    File.write!(name, code)
    binding

  "elixir", _before, code, binding ->
    code |> Code.eval_string(binding) |> elem(1)
end

blocks =
  Regex.split(~r/```(?:elixir|python)\n.*?```/s, File.read!(guide), include_captures: true)
  |> Enum.chunk_every(2)
  |> Enum.filter(&match?([_, _], &1))

true = length(blocks) > 3

Enum.reduce(blocks, [python: python], fn [before, block], binding ->
  [_, language, code] = Regex.run(~r/```(\w+)\n(.*)```/s, block)

  case Regex.run(~r/<!-- needs ([\w-]+) \((\w+)\) -->\s*\z/, before) do
    [_, package, module] ->
      if has.(module) do
        run.(language, before, code, binding)
      else
        IO.puts("SKIPPED: a block of the guide (#{python} has no #{package})")
        binding
      end

    nil ->
      run.(language, before, code, binding)
  end
end)

IO.puts("#{length(blocks)} blocks")
