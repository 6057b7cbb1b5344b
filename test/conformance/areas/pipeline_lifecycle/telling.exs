defmodule Situ.Conformance.PipelineLifecycle.Telling do
  # Sends messages from components to the case that runs them.

  def teller do
    me = self()
    tag = make_ref()
    {fn event -> send(me, {tag, event}) end, tag}
  end

  def drain(tag) do
    receive do
      {^tag, event} -> [event | drain(tag)]
    after
      0 -> []
    end
  end

  def values([%{"v" => _} | _] = messages), do: Enum.map(messages, & &1["v"])
  def values(values), do: values
end
