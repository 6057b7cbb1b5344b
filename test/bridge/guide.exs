# Runs the blocks of docs/guides/python.md in order: Elixir blocks here, and Python blocks in one
# separate process. A block that ends in `# => value` must return that value. `guide.exs GUIDE
# PYTHON`.
{:ok, _} = Application.ensure_all_started(:situ_bridge)
{:ok, _} = Application.ensure_all_started(:situ_dataset)
[guide, python] = System.argv()

port =
  Port.open({:spawn_executable, python}, [
    :binary,
    :exit_status,
    packet: 4,
    args: [Path.join(__DIR__, "python_blocks.py")]
  ])

run = fn
  "python", code, binding ->
    Port.command(port, code)

    receive do
      {^port, {:data, "ok"}} -> binding
      {^port, {:data, trouble}} -> raise "#{code}\n#{trouble}"
      {^port, {:exit_status, status}} -> raise "Python ended with status #{status}"
    after
      120_000 -> raise "Python does not come back from\n#{code}"
    end

  "elixir", code, binding ->
    {value, binding} =
      Code.eval_string("alias Situ.{Bridge, Image, Pipeline, Store}\n" <> code, binding)

    with [_, expected] <- Regex.run(~r/^# => (.*)\n/m, code) do
      {^value, _} = Code.eval_string(expected)
    end

    binding
end

# The guide's ports may be in use, so free ports replace them.
free = fn ->
  {text, 0} = System.cmd("python3", [Path.join(__DIR__, "free_port.py")])
  String.trim(text)
end

text =
  for port <- ~w(25511 25512),
      reduce: File.read!(guide),
      do: (text -> String.replace(text, port, free.()))

blocks = Regex.scan(~r/```(elixir|python)\n(.*?)```/s, text, capture: :all_but_first)
true = length(blocks) > 5
Enum.reduce(blocks, [], fn [language, code], binding -> run.(language, code, binding) end)
IO.puts("#{length(blocks)} blocks")
